"""A scene of MuJoCo's: its model, what may be put where in it, the objects that clients move, rays cast into it."""
