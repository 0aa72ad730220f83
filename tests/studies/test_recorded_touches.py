"""What a study says when its recorded touches are not there."""

from pathlib import Path

import pytest

from palpate.studies import Archive, recorded_touches


def test_a_folder_without_the_archive_is_named_with_where_to_fetch_it(tmp_path):
    archive = Path("tactip4") / "tactip4.npz"
    pins = Archive(archive, "a real dome")
    said = r"got .*\. Call `fetch\(tactip4\)` with that folder, or leave `data` out"
    with pytest.raises(ValueError, match=said):
        recorded_touches(tmp_path, pins)
