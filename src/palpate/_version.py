"""The version of palpate."""

__version__ = "0.2.0"
