"""Recorded touches that others published: fetched, checked, made into touch archives.

>>> from palpate import datasets
>>> datasets.card("tactip4")["touches"]
800

`load("tactip4")` returns its touches, `fetch("tactip4")` the path of its archive. A set
is fetched once, from its public source at a fixed commit or version, into `where()`.
"""

from ._fetch import card, fetch, load, names, where

__all__ = ["card", "fetch", "load", "names", "where"]
