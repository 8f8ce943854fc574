"""`python -m trolley.cli` is `trolley`."""

from trolley.cli import main

if __name__ == "__main__":
    main()
