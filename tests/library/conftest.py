"""What tests of the library share: rows changed behind its back."""

import sqlite3
from contextlib import closing

import pytest


@pytest.fixture
def alter():
    """Run statements on the database of a library, as another program might."""

    def run(folder, *statements):
        with closing(sqlite3.connect(folder / "library.sqlite")) as database:
            for statement in statements:
                database.execute(statement)
            database.commit()

    return run
