"""Grows the meshes of the scenery `forest`: `python grow.py`. The files lie beside this one and are kept."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

HERE = Path(__file__).parent
LENGTH_M, TOP_M = 170.0, 20.0  # of the lane's walls; its posts are as high
TREE_M = 3.8  # between two columns of a wood's edge
EDGE_M = 12.0  # shown by one width of the edge's picture
RADII_M = 0.5 * 1.16 ** np.arange(-15, 18)  # of trunks: the usual post's, thinner and thicker ones
SIDES = 6
SHADOW_M = 11.0  # as long as the sun makes a trunk's, up to its crown
KNOT = (68 / 128, 0.5)  # paint.KNOT


class Mesh(NamedTuple):
    """Points (n, 3) in metres, their places in the picture (n, 2), and triangles (m, 3), counter-clockwise."""

    vertex: NDArray[np.float64]
    texcoord: NDArray[np.float64]
    face: NDArray[np.int64]


def wood_edge(seed: int) -> Mesh:
    """170 m of a wood's edge along x, which lies behind y = 0 but for boughs that reach over the ride.

    Every second column is a tree, with boughs; between two of them the wood recedes.
    """
    random = np.random.default_rng(seed)
    columns = np.linspace(0.0, LENGTH_M, 2 * round(LENGTH_M / TREE_M / 2) + 1)
    points, texture = [], []
    for index, even_m in enumerate(columns):
        x = even_m + (random.uniform(-0.6, 0.6) if 0 < index < len(columns) - 1 else 0.0)
        profile = _tree(random) if index % 2 == 0 else _gap(random)
        points += [(x - LENGTH_M / 2, back, up) for back, up, _ in profile]
        texture += [(x / EDGE_M, 1.0 - v) for _, _, v in profile]  # a picture's top is 0
    faces = []
    for index in range(len(columns) - 1):
        for level in (0, 1):
            a, b = 3 * index + level, 3 * index + 3 + level
            faces += [(a, b, b + 1), (a, b + 1, a + 1)] if index % 2 else [(a, b, a + 1), (b, b + 1, a + 1)]
    return Mesh(np.array(points), np.array(texture), np.array(faces))


def _tree(random: np.random.Generator) -> list[tuple[float, float, float]]:
    """Metres back and up, and height in the picture: foot, where the boughs begin, their tip."""
    back = random.uniform(0.0, 0.2, 2)
    tip = (-random.uniform(2.0, 5.5), random.uniform(14.5, 17.5), 1.05)
    return [(back[0], 0.0, 0.0), (back[1], random.uniform(13.0, 14.0), 0.7), tip]


def _gap(random: np.random.Generator) -> list[tuple[float, float, float]]:
    return [(random.uniform(0.3, 0.7), 0.0, 0.0), (1.0, random.uniform(17.0, TOP_M), 0.9), (1.5, TOP_M, 1.0)]


def trunk(radius_m: float) -> Mesh:
    """A trunk on the origin, and along x from it its shadow on the ground, in the colour of the bark's knot."""
    turns = np.arange(SIDES + 1) / SIDES * 2 * np.pi
    rows = ((0.0, 1.1, 0.0), (0.7, 1.0, 0.2), (TOP_M, 0.85, 6.0))  # up, times the radius, height in the picture
    points = [
        (radius_m * times * np.cos(turn), radius_m * times * np.sin(turn), up)
        for up, times, _ in rows
        for turn in turns
    ]
    texture = [(2 * side / SIDES, v) for _, _, v in rows for side in range(SIDES + 1)]
    faces = []
    for row in range(len(rows) - 1):
        for a in range((SIDES + 1) * row, (SIDES + 1) * row + SIDES):
            above = a + SIDES + 1
            faces += [(a, a + 1, above + 1), (a, above + 1, above)]
    first, near, wide = len(points), 0.5 * radius_m, 0.95 * radius_m
    points += [(near, -wide, 0.01), (SHADOW_M, -0.8 * wide, 0.01), (SHADOW_M, 0.8 * wide, 0.01), (near, wide, 0.01)]
    faces += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
    return Mesh(np.array(points), np.array([*texture, *[KNOT] * 4]), np.array(faces))


def mjcf(name: str, mesh: Mesh) -> str:
    """An MJCF element; a mesh that is no closed body has the inertia of its surface."""
    fields = [
        f'{key}="{" ".join(f"{number:.4g}" for number in values.ravel())}"' for key, values in mesh._asdict().items()
    ]
    return f'    <mesh name="{name}" inertia="shell" {" ".join(fields)}/>'


def main() -> None:
    meshes = {f"edge_{side}": wood_edge(seed) for side, seed in (("west", 100), ("east", 101))}
    meshes |= {f"trunk_{number:02}": trunk(radius_m) for number, radius_m in enumerate(RADII_M)}
    radii = " ".join(f"{radius_m:.4g}" for radius_m in RADII_M)
    lines = ["<mujocoinclude>", "  <!-- Made by grow.py. -->", "  <asset>"]
    lines += [mjcf(name, mesh) for name, mesh in meshes.items()]
    lines += ["  </asset>", "  <custom>", f'    <numeric name="trunk_radii_m" data="{radii}"/>', "  </custom>"]
    (HERE / "meshes.xml").write_text("\n".join([*lines, "</mujocoinclude>", ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
