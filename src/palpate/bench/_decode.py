"""How long decoding a folder of JPEGs takes, and how much memory it needs.

Each side runs in a process of its own, so that its peak of memory is its own.
"""

import tempfile
from pathlib import Path

import numpy as np
from joblib import cpu_count

from ._timing import (
    N_COLS,
    N_ROWS,
    Row,
    coded,
    drawn_dome,
    measured_apart,
    real_touches,
    row,
)

_FRAME = """
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
_OURS = """
import cv2
from palpate.touches import read_folder
def work(folder): return read_folder(folder, progress=False).images
"""
_PEER = """
from pathlib import Path
import numpy as np
from joblib import cpu_count
from PIL import Image
def work(folder): return np.stack([np.asarray(Image.open(p).convert('L'))
    for p in sorted(Path(folder).rglob('*.jpg'))])
"""


def bench_decode(
    data: str | Path | None = None, *, repeats: int = 3, n_pictures: int = 772
) -> list[Row]:
    """Measure reading a folder of 640 x 480 JPEGs beside a plain Pillow loop.

    Without real touches (`bathtip/originals`) `n_pictures` are drawn; the fastest of
    `repeats` counts. Rows have CPU and wall time and peaks of memory in MiB.
    """
    real = real_touches(data)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        if real is None:
            _draw(folder, n_pictures)
        else:
            _link(real / "bathtip" / "originals", folder)
        # Once, so that neither side waits for the disk.
        for path in folder.iterdir():
            path.read_bytes()
        ours, peer = (
            measured_apart(_FRAME.format(work=work, repeats=repeats), folder)
            for work in (_OURS, _PEER)
        )
    size = f"{ours['n']:.0f} x {N_COLS} x {N_ROWS} uint8 JPEG"
    facts = {"n_cores": cpu_count(), "array_mib": ours["array_mib"]}
    facts |= {"peak_mib": ours["peak_mib"], "peak_before_mib": ours["before_mib"]}
    facts["peer_peak_mib"] = peer["peak_mib"]
    name = f"{size} {'drawn' if real is None else 'real'} folder"
    return [
        row(f"{name} {of}", ours[f"{of}_ms"], "Pillow loop", peer[f"{of}_ms"], **facts)
        for of in ("cpu", "wall")
    ]


def _draw(folder: Path, n_pictures: int) -> None:
    """Write pictures as large as the real touches, sixteen different ones."""
    rng = np.random.default_rng(0)
    pictures = [coded(drawn_dome(rng)) for _ in range(16)]
    for touch in range(n_pictures):
        (folder / f"img_{touch}.jpg").write_bytes(pictures[touch % len(pictures)])


def _link(originals: Path, folder: Path) -> None:
    """Link the real touches, without the picture of no contact among them."""
    for number, path in enumerate(sorted(originals.glob("*/*/*.jpg"))):
        (folder / f"img_{number}.jpg").symlink_to(path.resolve())
