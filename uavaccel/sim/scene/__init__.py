"""A MuJoCo scene: its model, limits of positions, the objects that clients move, and ray casting."""
