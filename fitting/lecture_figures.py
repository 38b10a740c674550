"""Write the figures of a lecture on illumination as PNG, each drawn by the model itself."""

import argparse
import sys
from pathlib import Path

import diffshade as ds


def main() -> None:
    """Read arguments, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, metavar="OUT", help="folder to write to; made where there is none")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="names of figures, for example snell (default: all)")
    arguments = parser.parse_args()

    for path in ds.lecture.write_figures(arguments.out, only=arguments.only, progress=True):
        print(path)


if __name__ == "__main__":
    try:
        main()
    except (OSError, ValueError, TypeError, ArithmeticError, RuntimeError) as error:
        sys.exit(f"lecture_figures: {error}")
