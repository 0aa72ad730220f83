"""Filters of a library's touches: of one object, of one image size."""


def of_object(name: str) -> tuple[str, bool]:
    """Return a filter of one object's touches, and whether it finds no others.

    A filter cannot quote a text that holds both kinds of quotation marks; such an
    object is sought by the pieces of its name, and others may hold those too.
    """
    for mark in "'\"":
        if mark not in name:
            return f"object = {mark}{name}{mark}", True
    pieces = [f"object contains '{piece}'" for piece in name.split("'") if piece]
    return " and ".join(pieces), False


def of_size(image_shape: tuple[int, int]) -> str:
    """Return a filter of the touches whose images have (n_rows, n_cols)."""
    return f"n_rows = {image_shape[0]} and n_cols = {image_shape[1]}"
