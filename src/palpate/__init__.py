"""Recognise things by touch: from tactile images to a belief over objects.

`import palpate` is cheap on purpose: the rooms that need scikit-learn or OpenCV
(`palpate.encodings`, `palpate.classifiers`, `palpate.recognition`...) are
imported by name.
"""

from .touches import Touches

__all__ = ["Touches", "__version__"]
__version__ = "0.2.0"
