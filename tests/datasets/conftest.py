"""A server on 127.0.0.1 replaces the sources; files have their layout."""

import gc
import io
import threading
import warnings
import zipfile
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest

from palpate.datasets import card, fetch, where

from ..cli.conftest import palpate as palpate


class Quiet(SimpleHTTPRequestHandler):
    requests: list[str]

    def log_message(self, *_):
        pass

    def do_GET(self):
        self.requests.append(self.path)
        if self.headers.get("Accept-Encoding") != "identity":
            self.send_error(400)
        super().do_GET()


class Sources:
    """The files of the server; `put` places one at the path of a set's source."""

    def __init__(self, folder, address, requests):
        self.folder, self.address, self.requests = folder, address, requests

    def put(self, name, content, path=None):
        place = self.folder / (path or urlsplit(card(name)["source"]["url"]).path[1:])
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)
        return place


@pytest.fixture
def sources(tmp_path, monkeypatch):
    pytest.importorskip("pooch")
    requests = []
    handler = type("Handler", (Quiet,), {"requests": requests})
    folder = tmp_path / "sources"
    folder.mkdir()
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(handler, directory=folder))
    thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    address = f"http://127.0.0.1:{server.server_port}"
    monkeypatch.setenv("PALPATE_DATA_MIRROR", address)
    monkeypatch.setenv("PALPATE_DATA", str(tmp_path / "fetched"))
    yield Sources(folder, address, requests)
    server.shutdown()
    server.server_close()
    thread.join()
    with warnings.catch_warnings():  # pooch leaves the socket of a failed download open
        warnings.simplefilter("ignore", ResourceWarning)
        gc.collect()


def files_in(folder):
    """Return the paths of all files in a folder, sorted."""
    paths = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return sorted(map(str, paths))


def refusal_of(name, match, error=ValueError):
    """Fetch a set that is refused and leaves no file; return the message."""
    with pytest.raises(error, match=match) as refusal:
        fetch(name)
    assert files_in(where()) == []
    return str(refusal.value)


def zipped(files):
    """Return a zip of files by path, under one folder as GitHub makes it."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for path, content in files.items():
            archive.writestr(f"repository-commit/{path}", content)
    return buffer.getvalue()


def png(levels):
    return cv2.imencode(".png", levels, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()


@pytest.fixture
def pins():
    """Six pictures in the layout of the set tactip4; its card leaves the last out."""
    rng = np.random.default_rng(0)
    levels = rng.integers(0, 255, (6, 12, 12), dtype=np.uint8)
    names = [
        "cuboid/_1",
        "cuboid/_2",
        "cuboid/_10",
        "prism/_2",
        "prism/_1",
        "cuboid/_4",
    ]
    root = "dataset-image/Dataset-shapes"
    files = {
        f"{root}/{name}.png": png(picture)
        for name, picture in zip(names, levels, strict=True)
    }
    return files, levels
