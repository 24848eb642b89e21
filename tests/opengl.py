"""The mark of tests that draw; conftest.py skips them where OpenGL is missing."""

import pytest

needs_opengl = pytest.mark.opengl
