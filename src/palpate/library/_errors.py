"""The errors of this room; all of them are `LibraryError`."""


class LibraryError(ValueError):
    """A library cannot do what was asked; the message names what and the fix."""


class DatabaseDamaged(LibraryError):
    """The database is lost, empty, cut or overwritten: a repair makes it anew."""


class DatabaseUnavailable(LibraryError):
    """The disk is full, fails or may not be written to.

    Nothing is known to be wrong with the library: no reason to repair it.
    """


class DatabaseBusy(DatabaseUnavailable):
    """Another program has kept the database to itself for too long."""


class NewerLibrary(LibraryError):
    """A newer palpate made the library."""
