"""One renderer for many simulations: a process with the only GL context, and cameras that request pictures from it."""
