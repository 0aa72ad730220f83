"""Recorded touches that others published, and ready models of simulated sensors.

>>> from palpate import datasets
>>> datasets.card("tactip4")["touches"]
800

`load("tactip4")` returns its touches, `fetch("tactip4")` the path of its archive. A set
is fetched once, from its public source at a fixed commit or version, into `where()`.
`fetch("sim-dome")` returns the path of a model that knows what the sensor `sim:dome`
touches; it is made on this computer when first asked for, in seconds.
"""

from ._fetch import READY as READY
from ._fetch import card, fetch, load, names, where

__all__ = ["card", "fetch", "load", "names", "where"]
