"""Cameras drawn off-screen: the OpenGL context, what a camera sees, the front camera, and cameras mounted anywhere."""
