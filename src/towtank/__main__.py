"""`python -m towtank` is the command `towtank`."""

from towtank.app.cli import main

if __name__ == "__main__":
    main()
