"""One renderer for many simulations: a process that owns the only GL context, and cameras that ask it for pictures."""
