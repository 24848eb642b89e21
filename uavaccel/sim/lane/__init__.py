"""The obstacle lane: where obstacles stand, a lane of one's own, the way through, and its bodies in MuJoCo."""
