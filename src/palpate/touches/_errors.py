"""The one error of this room."""


class TouchesError(ValueError):
    """Touches, a touch archive or a folder of pictures are not what they must be.

    The message names the file (or the argument), what was found and the fix.
    """
