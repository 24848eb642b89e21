"""Draw a stretch of an evaluated game as the moving picture of README.md: from behind, camera and events beside it.

    uavaccel evaluate --games 2 --out runs/evaluated
    python tools/draw_flight.py runs/evaluated docs/figures/flight.webp

An animated WebP, a frame for each sample of the flight, as in films.
"""

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

from uavaccel.draw.film import FRAMES_PER_S, PANEL, enlarged, to_bgr
from uavaccel.draw.style import Bgr, dvs_picture
from uavaccel.suites.flight import film_of, flight_of

LARGEST = 1_000_000  # bytes
BESIDE = (PANEL[0] // 2, PANEL[1] // 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="run directory of evaluate")
    parser.add_argument("picture", type=Path, help="WebP to write")
    parser.add_argument("--case", default="lane-000000", help="the game")
    parser.add_argument("--first", type=int, default=60, help="sample")
    parser.add_argument("--count", type=int, default=72, help="of samples")
    options = parser.parse_args()
    film = film_of(flight_of(options.run, options.case, None)[1])
    chase = film.chase
    assert chase is not None  # in a lane

    def frame(sample: int) -> Bgr:
        events = enlarged(dvs_picture(film.on_events[sample], film.off_events[sample]), BESIDE)
        beside = np.vstack([to_bgr(film.images[sample], BESIDE), events])
        return np.hstack([to_bgr(chase(sample), PANEL), beside])

    samples = range(options.first, min(options.first + options.count, len(film)))
    first, *others = [Image.fromarray(frame(sample)[..., ::-1]) for sample in samples]
    for quality in range(70, 0, -10):
        first.save(
            options.picture, save_all=True, append_images=others, duration=1000 // FRAMES_PER_S, loop=0, quality=quality
        )
        if options.picture.stat().st_size <= LARGEST:
            break
    print(f"{options.picture}: {len(samples)} frames of {film.title}, quality {quality}")


if __name__ == "__main__":
    main()
