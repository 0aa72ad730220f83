"""`python -m palpate` is the command `palpate`."""

from .cli import main

if __name__ == "__main__":
    main()
