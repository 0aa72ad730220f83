"""How long decoding a folder of JPEGs takes, and how much memory it needs.

Each side runs in a process of its own, so that its peak of memory is its own. The
peak is the kernel's high-water mark of that process (`VmHWM`): allocations of OpenCV
are invisible to `tracemalloc`, and `ru_maxrss` starts from the parent's value.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

_N_PICTURES = 772
_N_ROWS, _N_COLS = 480, 640
_QUALITY = 95  # drawn pictures of about 55 KiB, as the real ones
_MIB = 2**20

_FRAME = """
import json, sys, time
{imports}
def peak_mib():
    try:
        with open("/proc/self/status") as lines:
            return next(int(l.split()[1]) for l in lines if "VmHWM" in l) / 1024
    except OSError:
        import resource
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak / (2**20 if sys.platform == "darwin" else 2**10)
{work}
before = peak_mib()
spent = []
for _ in range({repeats}):
    images = None
    wall, cpu = time.perf_counter(), time.process_time()
    images = work(sys.argv[1])
    spent.append((time.perf_counter() - wall, time.process_time() - cpu))
wall, cpu = (1e3 * min(column) for column in zip(*spent))
print(json.dumps(dict(wall_ms=wall, cpu_ms=cpu, before_mib=before,
    peak_mib=peak_mib(), array_mib=images.nbytes / 2**20, n=len(images))))
"""
_OURS = {
    "imports": "import cv2\nfrom palpate.touches import read_folder",
    "work": "def work(folder): return read_folder(folder, progress=False).images",
}
_PEER = {
    "imports": "from pathlib import Path\nimport numpy as np\nfrom PIL import Image",
    "work": "def work(folder): return np.stack([np.asarray(Image.open(p).convert('L'))"
    " for p in sorted(Path(folder).rglob('*.jpg'))])",
}


def bench_decode(data: Path | None, *, repeats: int = 3) -> list[dict[str, Any]]:
    """Measure reading a folder of 640 x 480 JPEGs beside a plain Pillow loop.

    Parameters
    ----------
    data : Path or None
        The folder of real touches, whose `bathtip/originals` are read; None draws
        as many pictures of the same size.
    repeats : int, default=3
        Runs of each side, of which the fastest counts.

    Returns
    -------
    list of dict
        A row of CPU time and a row of wall time: `name`, `ours_ms`, `peer`,
        `peer_ms`, `ratio`, and the peaks of memory in MiB beside that of the
        resulting array. Ours also finds, labels and checks the files.
    """
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        kind = "drawn" if data is None else "real"
        if data is None:
            _draw(folder)
        else:
            _link(data / "bathtip" / "originals", folder)
        _warm(folder)
        ours, peer = (_measured(side, folder, repeats) for side in (_OURS, _PEER))
    return [_row(what, kind, ours, peer) for what in ("cpu", "wall")]


def bench_decode_here() -> list[dict[str, Any]]:
    """Measure on the pictures in PALPATE_DATA where it is set, else on drawn ones."""
    data = os.environ.get("PALPATE_DATA")
    return bench_decode(Path(data) if data else None)


def _row(
    what: str, kind: str, ours: dict[str, float], peer: dict[str, float]
) -> dict[str, Any]:
    from ..touches import n_cores

    ours_ms, peer_ms = ours[f"{what}_ms"], peer[f"{what}_ms"]
    size = f"{ours['n']:.0f} x {_N_COLS} x {_N_ROWS} uint8 JPEG"
    return {
        "name": f"{size} {kind} folder {what}",
        "ours_ms": ours_ms,
        "peer": "Pillow loop",
        "peer_ms": peer_ms,
        "ratio": peer_ms / ours_ms,
        "n_cores": n_cores(),
        "array_mib": ours["array_mib"],
        "peak_mib": ours["peak_mib"],
        "peak_before_mib": ours["before_mib"],
        "peer_peak_mib": peer["peak_mib"],
    }


def _measured(side: dict[str, str], folder: Path, repeats: int) -> dict[str, float]:
    code = _FRAME.format(**side, repeats=repeats)
    command = [sys.executable, "-c", code, str(folder)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return json.loads(done.stdout)


def _draw(folder: Path) -> None:
    """Write noisy blobs, as many and as large as the real touches."""
    import cv2

    rng = np.random.default_rng(0)
    row, col = np.mgrid[:_N_ROWS, :_N_COLS]
    pictures = []
    for centre in rng.uniform(150, 330, size=(16, 2)):
        blob = np.exp(-((row - centre[0]) ** 2 + (col - centre[1]) ** 2) / 5000)
        noisy = 60 + 120 * blob + rng.normal(scale=4, size=blob.shape)
        grey = noisy.clip(0, 255).astype(np.uint8)
        coded = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
        pictures.append(coded.tobytes())
    for touch in range(_N_PICTURES):
        (folder / f"img_{touch}.jpg").write_bytes(pictures[touch % len(pictures)])


def _link(originals: Path, folder: Path) -> None:
    """Link the real touches, without the picture of no contact among them."""
    for number, path in enumerate(sorted(originals.glob("*/*/*.jpg"))):
        (folder / f"img_{number}.jpg").symlink_to(path.resolve())


def _warm(folder: Path) -> None:
    """Read every file once, so that neither side waits for the disk."""
    for path in folder.iterdir():
        path.read_bytes()
