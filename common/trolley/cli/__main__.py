"""`python -m trolley.cli` is `trolley`."""

from trolley.start import command

if __name__ == "__main__":
    command()
