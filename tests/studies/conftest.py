"""A study small enough to run in a test: three parts, six presses of each."""

import pytest

from palpate.studies.liu2014 import Liu2014Plan

TINY = {
    "parts": (3, 7, 12),
    "n_presses": 6,
    "runs": 2,
    "counts": (5, 40),
    "partitions": (2, 1),
    "loads_kgf": (2.0, 4.0),
    "covers_mm": (0.9,),
    "inner_folds": 2,
    "widths": (1.0,),
    "components": (3, 6),
    "svm_widths": (1.0, 2.0),
    "svm_costs": (10.0,),
    "mkl_costs": (1e3,),
}
# Nothing to choose from, where only the rows matter.
LEAST = {
    "runs": 1,
    "counts": (5,),
    "partitions": (2,),
    "loads_kgf": (),
    "covers_mm": (),
    "components": (6,),
    "svm_widths": (1.0,),
}


def rows_of(result, **wanted):
    """Return the rows of a result that have these entries."""
    return [
        row
        for row in result["rows"]
        if all(row.get(key) == value for key, value in wanted.items())
    ]


@pytest.fixture(scope="session")
def tiny_plan():
    """Make the tiny plan, with changes."""

    def make(**changes):
        return Liu2014Plan(**{**TINY, **changes})

    return make


@pytest.fixture(scope="session")
def least_plan(tiny_plan):
    """Make the tiny plan with one run and one setting of each method, with changes."""

    def make(**changes):
        return tiny_plan(**{**LEAST, **changes})

    return make
