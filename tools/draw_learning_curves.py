"""Draw trainings' success over the wall clock, a line for each run directory, the paper's real time beside them.

    python tools/draw_learning_curves.py docs/figures/learning_curves.png "one H200=runs/a" "two cores=runs/b"

Runs of one name are one line, their mean, in the band of their range.
"""

import argparse
from pathlib import Path

from uavaccel.draw import style
from uavaccel.records import RunDirectory
from uavaccel.suites.train import Training, curves_figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", type=Path, help="PNG to write")
    parser.add_argument("runs", nargs="+", help="NAME=FOLDER")
    options = parser.parse_args()
    names, folders = zip(*(run.rpartition("=")[::2] for run in options.runs), strict=True)
    reports = [Training().report(RunDirectory(folder)) for folder in folders]
    with style.project_style():
        print(style.save(curves_figure("wall clock", reports, names), options.picture))


if __name__ == "__main__":
    main()
