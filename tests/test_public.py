"""The public promise: what a room's `__all__` names is there and says what it is."""

import inspect
import runpy
from importlib import import_module
from pathlib import Path

import pytest

from structure import import_circles, public_names

SOURCE = Path(__file__).parents[1] / "src"
ROOMS = public_names(SOURCE / "palpate")


def room_named(name):
    """Import a room; one that needs an extra is skipped where it is not installed."""
    return import_module(f"palpate.{name}")


@pytest.mark.parametrize("name", ROOMS)
def test_every_name_is_there_once_and_in_order(name):
    room = room_named(name)
    assert [n for n in room.__all__ if not hasattr(room, n)] == []
    assert len(set(room.__all__)) == len(room.__all__)
    assert set(room.__all__) <= set(dir(room))


@pytest.mark.parametrize("name", ROOMS)
def test_every_public_class_and_function_has_a_docstring(name):
    room = room_named(name)
    public = {f"{name}.{n}": getattr(room, n) for n in room.__all__}
    silent = [
        full
        for full, thing in public.items()
        if (inspect.isclass(thing) or inspect.isroutine(thing)) and not own_doc(thing)
    ]
    assert silent == []


def own_doc(thing):
    """Return a docstring that was written: dataclasses get their signature as one."""
    written = (vars(thing) if inspect.isclass(thing) else {}).get("__doc__")
    documented = written if inspect.isclass(thing) else inspect.getdoc(thing)
    generated = documented and documented.startswith(f"{thing.__name__}(")
    return None if generated else documented


@pytest.mark.parametrize("name", ROOMS)
def test_every_public_method_has_a_docstring(name):
    """Methods that are inherited say it where they are defined."""
    room = room_named(name)
    silent = [
        f"{name}.{n}.{method}"
        for n in room.__all__
        if inspect.isclass(thing := getattr(room, n))
        and thing.__module__.startswith("palpate")
        for method, function in vars(thing).items()
        if not method.startswith("_")
        and callable(function)
        and not inspect.getdoc(getattr(thing, method))
    ]
    assert silent == []


def test_the_root_offers_what_it_names():
    root = import_module("palpate")
    assert [n for n in root.__all__ if not hasattr(root, n)] == []
    assert set(root.__all__) <= set(dir(root))


def test_a_stranger_can_keep_the_public_names_in_mind():
    assert sum(map(len, ROOMS.values())) <= 130


def test_no_modules_import_each_other():
    """Imports inside functions count too; those for types alone do not."""
    assert import_circles(SOURCE, deferred=True) == []


@pytest.mark.parametrize("name", ROOMS)
def test_signatures_in_help_are_short(name):
    """No default that is a whole table, no annotation that is spelt out."""
    room = room_named(name)
    long = {}
    for public in room.__all__:
        thing = getattr(room, public)
        methods = vars(thing).items() if inspect.isclass(thing) else ()
        functions = {f"{public}.{n}": f for n, f in methods if inspect.isfunction(f)}
        for full, function in {**functions, public: thing}.items():
            signature = signature_of(function)
            if len(signature) > 800 or "_SupportsArray" in signature:
                long[full] = signature[:100]
    assert long == {}


def signature_of(thing):
    try:
        return str(inspect.signature(thing)) if callable(thing) else ""
    except ValueError:  # built in
        return ""


def test_the_page_of_public_names_is_made_from_the_code():
    docs = SOURCE.parent / "docs"
    page = docs / "reference" / "names.md"
    code = runpy.run_path(str(docs / "reference.py"))
    assert page.read_text() == code["reference"](), "run: python docs/reference.py"
