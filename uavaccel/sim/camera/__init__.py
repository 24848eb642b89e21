"""Off-screen cameras: OpenGL contexts, a camera's view, the front camera, and cameras with any pose."""
