"""A study small enough to run in a test: three parts, six presses of each."""

import re

import pytest

from palpate.studies import held
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
    return held(result["rows"], **wanted)


def titles_of(study, result):
    """Return what stands above the tables, which have a cell for every column."""
    for _, columns, rows in study.tables(result):
        assert {len(row) for row in rows} == {len(columns)}
    return [title for title, _, _ in study.tables(result)]


def page_of(study, result, folder):
    """Return a study's page, and what its pictures show: alt text and caption alike."""
    page = study.write_report(folder / "page.html", result).read_text("utf-8")
    assert page.startswith("<!doctype html>")
    assert "<script" not in page
    loaded = re.findall(r"""(?:src|href)=["']?([^"' >]+)""", page)
    assert all(address.startswith(("#", "data:")) for address in loaded)
    alt_texts = re.findall(r'<svg role="img" aria-label="([^"]+)"', page)
    assert len(alt_texts) == page.count("<svg")
    assert re.findall(r"<figcaption><b>(.*?)\.</b>", page) == alt_texts
    return page, alt_texts


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
