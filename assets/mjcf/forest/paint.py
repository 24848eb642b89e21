"""Paints the pictures of the scenery `forest` out of noise and ellipses: `python paint.py`.

They lie beside this file and are kept, so that what is drawn from them is the same on every machine.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

HERE = Path(__file__).parent
SHADES = 48  # colours of a picture: a palette keeps it small

Array = NDArray[np.float64]
Colour = tuple[float, float, float]  # red, green, blue from 0 to 1
Colours = tuple[Colour, Colour]  # in the shade, in the light


def noise(rows: int, columns: int, roughness: float, seed: int, stretch: float = 1.0) -> Array:
    """Noise (rows, columns) of mean 0 and deviation 1 without a seam; `stretch` > 1 draws it out sideways."""
    spectrum = np.fft.fft2(np.random.default_rng(seed).standard_normal((rows, columns)))
    radius = np.hypot(np.fft.fftfreq(rows)[:, None], stretch * np.fft.fftfreq(columns)[None, :])
    radius[0, 0] = np.inf
    drawn = np.fft.ifft2(spectrum / radius**roughness).real
    return np.asarray((drawn - drawn.mean()) / drawn.std())


def mixed(share: Array, low: Colour, high: Colour) -> Array:
    """Colours between two."""
    share = np.clip(share, 0.0, 1.0)[..., None]
    return np.asarray((1 - share) * np.array(low) + share * np.array(high))


def smooth(values: Array, low: float, high: float) -> Array:
    """0 up to `low`, 1 from `high` on, smooth between."""
    share = np.clip((values - low) / (high - low), 0.0, 1.0)
    return np.asarray(share * share * (3 - 2 * share))


def over(picture: Array, share: Array, colour: Colour | Array) -> Array:
    """A colour laid over a picture."""
    return np.asarray(picture * (1 - share[..., None]) + np.array(colour) * share[..., None])


def save(name: str, picture: Array) -> None:
    """A picture (rows, columns, 3) in SHADES colours."""
    pixels = np.float32(np.clip(picture, 0, 1).reshape(-1, 3) * 255)
    cv2.setRNGSeed(1)
    end = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 12, 1.0)
    some = pixels[:: max(1, len(pixels) // 20_000)]
    _, _, palette = cv2.kmeans(some, SHADES, np.empty(0), end, 1, cv2.KMEANS_PP_CENTERS)
    palette = palette[np.argsort(palette.sum(axis=1))]
    parts = np.array_split(pixels, 64)
    nearest = [((part[:, None] - palette) ** 2).sum(axis=2).argmin(axis=1) for part in parts]
    image = Image.fromarray(np.concatenate(nearest).reshape(picture.shape[:2]).astype(np.uint8), "P")
    image.putpalette(np.rint(palette).astype(np.uint8).ravel().tolist())
    image.save(HERE / f"{name}.png", optimize=True)


# --- bark: 1.6 m around, 3.3 m high -----------------------------------------------------------------------------

BARK = (256, 128)
KNOT = (128, 68)  # where every bark is dark; trunks' shadows on the ground are of that colour
KNOT_COLOUR = (0.11, 0.12, 0.06)


def furrowed(shades: Colours, seed: int, depth: float) -> Array:
    """Bark of plates, drawn out upwards, with dark furrows between."""
    plates = mixed(0.5 + 0.32 * noise(*BARK, 1.2, seed, stretch=0.35), *shades)
    furrows = smooth(np.abs(noise(*BARK, 1.35, seed + 1, stretch=0.28)), 0.05, 0.33)
    grain = 1 + 0.06 * noise(*BARK, 0.4, seed + 2)
    return np.asarray(plates * ((1 - depth + depth * furrows) * grain)[..., None])


def pine() -> Array:
    return furrowed(((0.42, 0.23, 0.13), (0.78, 0.5, 0.32)), 1, 0.7)


def birch() -> Array:
    bark = mixed(0.6 + 0.2 * noise(*BARK, 1.3, 4), (0.66, 0.64, 0.6), (0.95, 0.94, 0.9))
    lines = 0.8 * smooth(noise(*BARK, 1.0, 5, stretch=4.0), 1.4, 1.9)
    scars = smooth(noise(*BARK, 1.6, 6, stretch=1.5), 1.35, 1.6)
    return over(bark, np.maximum(lines, scars), (0.1, 0.09, 0.09))


def larch() -> Array:
    lichen = 0.85 * smooth(noise(*BARK, 1.3, 9), 0.2, 0.9)
    yellow = np.array((0.8, 0.7, 0.22)) * (0.85 + 0.15 * noise(*BARK, 0.5, 10))[..., None]
    return over(furrowed(((0.3, 0.24, 0.17), (0.6, 0.5, 0.36)), 7, 0.65), lichen, yellow)


def beech() -> Array:
    bark = mixed(0.5 + 0.25 * noise(*BARK, 1.5, 11), (0.36, 0.4, 0.44), (0.66, 0.71, 0.76))
    rings = 0.4 * smooth(noise(*BARK, 1.1, 12, stretch=5.0), 1.2, 2.2)
    moss = 0.8 * smooth(noise(*BARK, 1.6, 13, stretch=0.6), 0.7, 1.3)
    return over(over(bark, rings, (0.0, 0.0, 0.0)), moss, (0.28, 0.4, 0.16))


def knotted(bark: Array) -> Array:
    down, right = np.mgrid[: BARK[0], : BARK[1]]
    return over(bark, smooth(np.hypot((down - KNOT[0]) / 10, (right - KNOT[1]) / 8), 0.9, 0.5), KNOT_COLOUR)


# --- ground: a tile of 10 m, as wide as the lane ----------------------------------------------------------------

GROUND = 512
LEAVES_FALLEN = ((0.5, 0.33, 0.17), (0.62, 0.45, 0.22), (0.36, 0.25, 0.15))


def ground(seed: int, earth: Colours, green: Colours, worn_m: float) -> Array:
    """A ride: earth and leaves along its middle, to `worn_m` either side, then green, and dark below the trees."""
    size = GROUND
    across_m = ((np.arange(size) + 0.5) / size * 10.0 - 5.0)[:, None]
    bare = mixed(0.5 + 0.3 * noise(size, size, 0.9, seed + 1), *earth)
    strew(bare, np.random.default_rng(seed + 2))
    grass = mixed(0.5 + 0.33 * noise(size, size, 0.75, seed + 3), *green)
    wear_m = np.abs(across_m + 0.5 * noise(size, size, 2.2, seed)) + 0.5 * noise(size, size, 1.3, seed + 4)
    picture = over(bare, smooth(wear_m, worn_m, worn_m + 1.3), grass)
    dapples = 0.86 + 0.2 * smooth(noise(size, size, 2.0, seed + 5), -0.5, 0.7)
    below_trees = 0.45 + 0.55 * smooth(5.0 - np.abs(across_m), 0.0, 1.4)
    picture *= (dapples * below_trees)[..., None]
    return np.roll(picture, size // 2, axis=0)  # MuJoCo's tiles begin in the middle of a plane


def strew(picture: Array, random: np.random.Generator) -> None:
    """Leaves on the ground, around the picture's ends too."""
    for _ in range(2600):
        x, y = random.uniform(0, GROUND, 2)
        colour = np.array(LEAVES_FALLEN[random.integers(3)]) * random.uniform(0.5, 1.25)
        axes = (int(random.integers(2, 5)), int(random.integers(1, 3)))
        turn = random.uniform(0, 180)
        for right in wrapped(x, GROUND, 8):
            for down in wrapped(y, GROUND, 8):
                cv2.ellipse(picture, (int(right), int(down)), axes, turn, 0, 360, colour.tolist(), -1)


def wrapped(place: float, size: int, margin: float) -> list[float]:
    """Where something near an end is to be drawn, so that the picture repeats without a seam."""
    return [each for each in (place - size, place, place + size) if -margin < each < size + margin]


# --- the edge of a wood: 12 m wide, 20 m high -------------------------------------------------------------------

EDGE = 512


def edge(seed: int, green: Colours, stems: Colour, leaf: int, flatness: float) -> Array:
    """Stems in the dark, boughs before them, bushes at the foot; repeats sideways."""
    random = np.random.default_rng(seed)
    down = np.linspace(0, 1, EDGE)[:, None]
    dark = 0.35 + 0.25 * noise(EDGE, EDGE, 1.5, seed + 1) + 0.1 * down
    picture = mixed(dark, (0.04, 0.07, 0.045), (0.18, 0.26, 0.13))
    for _ in range(13):
        draw_stem(picture, np.array(stems) * random.uniform(0.35, 0.9), random)
    for layer in range(4):
        for _ in range(44):
            middle = random.uniform(0, EDGE), EDGE * (1 - random.uniform(0.16 + 0.02 * layer, 1.02))
            radius = random.uniform(18, 44)
            lit = (0.55 + 0.15 * layer) * np.array(green)
            draw_clump(picture, middle, (radius, flatness * radius), lit, leaf, random)
    for layer in range(3):
        for _ in range(22):
            middle = random.uniform(0, EDGE), EDGE * (1 - random.uniform(0, 0.13 - 0.035 * layer))
            radius = random.uniform(14, 30)
            lit = (0.6 + 0.2 * layer) * np.array(green) * ((1, 1, 1), (1.15, 1.2, 0.9))
            draw_clump(picture, middle, (radius, 0.7 * radius), lit, 3, random)
    return np.asarray(picture * (0.75 + 0.25 * smooth(1 - down, 0.0, 0.1))[..., None])


def draw_stem(picture: Array, colour: Array, random: np.random.Generator) -> None:
    foot, lean, width = random.uniform(0, EDGE), random.normal(0, 6), int(random.integers(5, 13))
    for x in wrapped(foot, EDGE, 30):
        cv2.line(picture, (int(x), EDGE), (int(x + lean), 0), colour.tolist(), width)


def draw_clump(
    picture: Array,
    middle: tuple[float, float],
    radii: tuple[float, float],
    lit: Array,
    leaf: int,
    random: np.random.Generator,
) -> None:
    """Leaves of about `leaf` pixels around a middle, lit from above."""
    for _ in range(int(5.5 * radii[0])):
        angle, far = random.uniform(0, 2 * np.pi), np.sqrt(random.uniform())
        light = np.clip(0.62 - 0.42 * np.sin(angle) * far + random.normal(0, 0.14), 0.0, 1.1)
        colour = (lit[0] + light * (lit[1] - lit[0])).tolist()
        length, width = random.uniform(0.6, 1.4, 2) * (leaf, 0.5 * leaf)
        axes, turn = (max(1, round(length)), max(1, round(width))), random.uniform(-60, 60)
        y = round(middle[1] + far * np.sin(angle) * radii[1])
        for x in wrapped(middle[0] + far * np.cos(angle) * radii[0], EDGE, 2 * leaf):
            cv2.ellipse(picture, (round(x), y), axes, turn, 0, 360, colour, -1)


# --- sky --------------------------------------------------------------------------------------------------------

SKY = 256


def sky_colours(direction: Array) -> Array:
    """Of directions (..., 3), z up: blue above, haze at the horizon, clouds that lie on a flat ceiling."""
    up = direction[..., 2]
    base = mixed(np.clip(up, 0, 1) ** 0.6, (0.86, 0.9, 0.93), (0.25, 0.46, 0.78))
    field = noise(512, 512, 1.75, 40)
    column, row = np.moveaxis(np.floor(direction[..., :2] / np.maximum(up, 0.03)[..., None] * 30 + 256), -1, 0)
    thick = smooth(field[row.astype(int) % 512, column.astype(int) % 512], 0.0, 1.5)
    return over(base, thick * smooth(up, 0.05, 0.25), mixed(1 - 0.5 * thick, (0.78, 0.8, 0.84), (1, 1, 0.99)))


def sky() -> dict[str, Array]:
    """Faces of OpenGL's cube map, seen from inside; its y is MuJoCo's z."""
    line = (np.arange(SKY) + 0.5) / SKY * 2 - 1
    s, t = np.meshgrid(line, line)
    one = np.ones_like(s)
    faces = {
        "right": (one, -t, -s),
        "left": (-one, -t, s),
        "up": (s, one, t),
        "down": (s, -one, -t),
        "front": (s, -t, one),
        "back": (-s, -t, -one),
    }
    ways = {name: np.stack([x, -z, y], axis=-1) for name, (x, y, z) in faces.items()}
    return {name: sky_colours(way / np.linalg.norm(way, axis=-1, keepdims=True)) for name, way in ways.items()}


def main() -> None:
    for name, bark in (("pine", pine()), ("birch", birch()), ("larch", larch()), ("beech", beech())):
        save(f"bark_{name}", knotted(bark))
    earth = ((0.2, 0.14, 0.09), (0.44, 0.33, 0.22)), ((0.24, 0.2, 0.11), (0.44, 0.38, 0.22))
    save("ground_path", ground(50, earth[0], ((0.13, 0.2, 0.07), (0.36, 0.44, 0.18)), 1.6))
    save("ground_moss", ground(60, earth[1], ((0.15, 0.24, 0.08), (0.42, 0.52, 0.2)), 0.2))
    save("edge_spruce", edge(70, ((0.05, 0.11, 0.07), (0.5, 0.66, 0.36)), (0.5, 0.4, 0.3), 5, 0.55))
    save("edge_beech", edge(80, ((0.1, 0.16, 0.03), (0.82, 0.88, 0.34)), (0.75, 0.72, 0.66), 4, 0.85))
    for name, face in sky().items():
        save(f"sky_{name}", face)


if __name__ == "__main__":
    main()
