"""The arrays that images are rendered from, and the layout of their rows: plain numbers, as a GPU needs them."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

# What compiled functions take, whose types numba infers when it compiles them.
Operand: TypeAlias = Any
"""A NumPy array or, on a GPU, a numba array on a tensor's memory; a tuple of those; or a float32 or float64."""
Launchable: TypeAlias = Any
"""A compiled function, or a CUDA kernel, which takes its launch configuration in brackets first."""
Float: TypeAlias = Any
"""A float32 or float64: numba keeps a scalar's type."""
Integer: TypeAlias = Any
"""An int32: with a Python int numba would compute in 64 bits."""
Vector: TypeAlias = tuple[Float, Float, Float]


class Appearance(NamedTuple):
    """The appearance of a model, which all lanes of a batch share; read only."""

    texels: NDArray[np.uint32]
    """(T,): red | green << 8 | blue << 16, all mipmap levels of all textures."""
    textures: NDArray[np.int32]
    """(n, 2): BASE, LOG2_SIZE; texture 0 is the sky's cube map."""
    materials: NDArray[np.float32]
    """(m, 8): RGB, TEXTURE_ID, REPEAT, UNIFORM, EMISSION."""
    camera: NDArray[np.float64]
    """(16,): PLACE and AXES in the body frame, HALF_WIDTH, HALF_HEIGHT, NEAR_M, FAR_M."""
    fixed: NDArray[np.float32]
    """(f, 8): walls and ground, the solids that every lane has."""
    wearing: NDArray[np.int32]
    """(3, 4): materials of obstacles by LaneLayout.texture, walls by .wall_texture, ground by .ground_texture."""


class Looks(NamedTuple):
    """How a still scene is seen (kernels/casting); read only."""

    camera: NDArray[np.float64]
    """(16,): as in Appearance, for the pictures' size."""
    light: NDArray[np.float32]
    """(9,): as in Scenes."""
    texels: NDArray[np.uint32]
    textures: NDArray[np.int32]
    """As in Appearance."""
    materials: NDArray[np.float32]
    """(m, 8): as in Appearance; TEXTURE_ID is 0 without a texture."""


class Scenes(NamedTuple):
    """The visible geometry of a batch's lanes, a row each."""

    solids: NDArray[np.float32]
    """(L, SOLIDS, 8): MIDDLE, HALF_SIZE, KIND, MATERIAL; metres, MuJoCo's axes."""
    counts: NDArray[np.int32]
    """(L,): number of solids in use."""
    lights: NDArray[np.float32]
    """(L, 9): AMBIENT, DIFFUSE, and the direction TOWARDS the sun in MuJoCo's axes."""


def empty_scenes(lanes: int) -> Scenes:
    """Allocate scenes for `lanes` lanes, to be filled by `fill_scenes` before they are rendered."""
    solids = np.zeros((lanes, SOLIDS, 8), np.float32)
    return Scenes(solids, np.zeros(lanes, np.int32), np.zeros((lanes, 9), np.float32))


STATE, DVS, COLOUR, DEPTH = range(4)  # kinds of observation
SEEN_FAR_M = np.float32(50.0)  # depth that an observation encodes as 255
ROWS, COLUMNS = 144, 256  # of an image; row 0 is at the top
SLICES = 8  # sides of the prism that MuJoCo draws for a cylinder: visual/quality/numslices of the models

# An image's faces: float32 (FACES, FIELDS). A linear function is three numbers: per column, per row, at pixel (0, 0).
FACES, FIELDS = 400, 32  # enough for 64 cylinders, two walls and the ground
RAYS = 0  # in row 0, which belongs to the image: the ray's x, y, z per metre of depth, three linear functions
FAR_W, NEAR_W, COUNT = 9, 10, 11  # inverse depth of far and near plane; rows in use

W = 0  # inverse depth
EDGES = 3  # four functions, >= 0 inside: metres from low and high edge across, then from bottom and top, times w
ACROSS, DOWN = EDGES, EDGES + 9  # the edges from which texture coordinates count
TU, TV = 15, 17  # texels (level 0) per metre across or down, and at the edge
TEXTURE = 19
COLOUR, SLOPE = 20, 23  # reflected light at the low edge (0 to 1), and its change per metre across
EXTRA = 26  # row with eight more edges, 0 for none; such a row is not a face, and its NEAREST_W is 0
NEAREST_W = 27  # upper bound of w
FIRST_COLUMN, LAST_COLUMN = 28, 29  # range of columns in which it may be visible

# A texture: int32 (2,), in Appearance.textures; texture 0 is the sky's. Mipmap levels are stacked vertically.
BASE, LOG2_SIZE = 0, 1  # textures are square, and LOG2_SIZE is the last level

# A material: float32 (8,), in Appearance.materials.
RGB, TEXTURE_ID, REPEAT, UNIFORM, EMISSION = 0, 3, 4, 6, 7

# A solid: float32 (8,), in Scenes.solids. Metres, MuJoCo's axes.
MIDDLE, HALF_SIZE, KIND, MATERIAL = 0, 3, 6, 7
BOX, CYLINDER, PLANE = 0, 1, 2
SOLIDS = 67  # obstacles, two walls, the ground

# A lane's light: float32 (9,), in Scenes.lights; TOWARDS is the direction to the sun.
AMBIENT, DIFFUSE, TOWARDS = 0, 3, 6

# The camera: float64 (16,), in Appearance.camera. In the body frame: place; axes right, up, back, a matrix's columns.
PLACE, AXES, HALF_WIDTH, HALF_HEIGHT, NEAR_M, FAR_M = 0, 3, 12, 13, 14, 15


NO_APPEARANCE = Appearance(
    np.zeros(0, np.uint32),
    np.zeros((0, 4), np.int32),
    np.zeros((0, 8), np.float32),
    np.zeros(16),
    np.zeros((0, 8), np.float32),
    np.zeros((3, 4), np.int32),
)
"""Stands for the appearance of lanes that render no images: empty arrays of the same types."""

NO_LOOKS = Looks(np.zeros(16), np.zeros(9, np.float32), *NO_APPEARANCE[:3])
"""The same for lanes in scenes of shapes of any kind."""
