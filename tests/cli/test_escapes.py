"""What a terminal would obey is shown, not printed raw."""

import numpy as np

from palpate import Touches
from palpate.library import TouchLibrary


def test_escapes_in_texts_of_a_library_are_shown(palpate, tmp_path):
    with TouchLibrary.open(tmp_path, create=True) as library:
        images = np.zeros((2, 3, 3), np.uint8)
        library.add(Touches(images, session=["\x1b[2J", "b"], object=["pen", "cup"]))
        key = library.list()[0].id
    for arguments in (["list", tmp_path], ["show", tmp_path, key]):
        done = palpate("library", *arguments)
        assert done.returncode == 0
        assert "\x1b[2J" not in done.stdout
        assert r"\x1b[2J" in done.stdout
