"""Random histories of changes, kills, repairs and copies, beside a simple reference."""

import pytest
from machines import LibraryMachine, play


@pytest.mark.parametrize("seed", range(2))
def test_the_library_is_where_a_reference_is(seed):
    play(LibraryMachine, seed, n_sequences=3)


@pytest.mark.slow
def test_many_histories():
    play(LibraryMachine, 100, n_sequences=300)
