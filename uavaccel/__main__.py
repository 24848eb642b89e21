"""`python -m uavaccel`: the command line without an installed script."""

from uavaccel.cli.main import main

if __name__ == "__main__":
    main()
