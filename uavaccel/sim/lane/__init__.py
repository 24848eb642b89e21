"""The obstacle lane: random and user-defined layouts, a path planner, and the lane's geoms in MuJoCo."""
