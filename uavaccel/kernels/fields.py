"""The arrays that are drawn from, and what stands where in their rows: plain numbers, so that they can lie on a GPU."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Looks(NamedTuple):
    """What a model looks like, of which all lanes of a batch are; read only."""

    texels: NDArray[np.uint32]
    """(T,): red | green << 8 | blue << 16, every level of every texture."""
    textures: NDArray[np.int32]
    """(n, 2): BASE, LOG2_SIZE; texture 0 is the sky's cube map."""
    materials: NDArray[np.float32]
    """(m, 8): RGB, TEXTURE_ID, REPEAT, UNIFORM, EMISSION."""
    camera: NDArray[np.float64]
    """(16,): PLACE in the body, AXES there (right, up, back, columns of a matrix), HALF_WIDTH, ..., FAR_M."""
    fixed: NDArray[np.float32]
    """(f, 8): the solids that every lane has, walls and ground, as the model has them."""
    wearing: NDArray[np.int32]
    """(3, 4): materials of obstacles by LaneLayout.texture, of the walls by .wall_texture, of the ground."""


class Scenes(NamedTuple):
    """The lanes of a batch, a row each."""

    solids: NDArray[np.float32]
    """(L, SOLIDS, 8): MIDDLE, HALF_SIZE, KIND, MATERIAL: metres, MuJoCo's axes."""
    counts: NDArray[np.int32]
    """(L,): rows of `solids` in use."""
    lights: NDArray[np.float32]
    """(L, 9): AMBIENT, DIFFUSE, and the direction TOWARDS the sun, MuJoCo's axes."""


STATE, DVS, COLOUR, DEPTH = range(4)  # what is observed
SEEN_FAR_M = np.float32(50.0)  # depth that is shown as 255
ROWS, COLUMNS = 144, 256  # of a picture; the top row is row 0
SLICES = 8  # sides of what MuJoCo draws for a cylinder, by the models' visual/quality/numslices

# A picture's faces: float32 (FACES, FIELDS). A linear function is three numbers: per column, per row, at pixel (0, 0).
FACES, FIELDS = 400, 32  # as many as 64 cylinders, two walls and a ground can show at once
RAYS = 0  # row 0 is the picture's own: the ray's x, y, z per metre of depth, three linear functions
FAR_W, NEAR_W, COUNT = 9, 10, 11  # 1/depth of the far and the near plane; rows in use

W = 0  # 1/depth
EDGES = 3  # four functions >= 0 inside: metres from the low and high end across, then from bottom and top, times w
ACROSS, DOWN = EDGES, EDGES + 9  # those of them that textures count from
TU, TV = 15, 17  # texels (level 0) per metre across or down, and at the edge
TEXTURE = 19
COLOUR, SLOPE = 20, 23  # of the light that it throws back at its low end (0 to 1), and per metre across
EXTRA = 26  # row with eight more edges, 0 for none; such a row is no face: its NEAREST_W is 0
NEAREST_W = 27  # upper bound of w
FIRST_COLUMN, LAST_COLUMN = 28, 29  # columns of pixels beyond which it is not seen

# A texture: int32 (2,), in Looks.textures; texture 0 is the sky's. Levels stand one below the other.
BASE, LOG2_SIZE = 0, 1  # square; the last level is LOG2_SIZE, too

# A material: float32 (8,), in Looks.materials.
RGB, TEXTURE_ID, REPEAT, UNIFORM, EMISSION = 0, 3, 4, 6, 7

# A solid: float32 (8,), in Scenes.solids. Metres, MuJoCo's axes.
MIDDLE, HALF_SIZE, KIND, MATERIAL = 0, 3, 6, 7
BOX, CYLINDER, PLANE = 0, 1, 2
SOLIDS = 67  # obstacles, two walls, the ground

# A lane's light: float32 (9,), in Scenes.lights; the direction is that towards the sun.
AMBIENT, DIFFUSE, TOWARDS = 0, 3, 6

# The camera: float64 (16,), in Looks.camera: place in the body; axes there, columns of a matrix: right, up, back.
PLACE, AXES, HALF_WIDTH, HALF_HEIGHT, NEAR_M, FAR_M = 0, 3, 12, 13, 14, 15


NO_LOOKS = Looks(
    np.zeros(0, np.uint32),
    np.zeros((0, 4), np.int32),
    np.zeros((0, 8), np.float32),
    np.zeros(16),
    np.zeros((0, 8), np.float32),
    np.zeros((3, 4), np.int32),
)
"""Of lanes that nobody looks at: arrays of the same types."""
