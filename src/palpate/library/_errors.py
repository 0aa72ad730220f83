"""The one error of this room."""


class LibraryError(ValueError):
    """A library cannot do what was asked; the message names what and the fix."""
