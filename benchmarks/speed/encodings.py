"""From a 640 x 480 picture to a vector, stage by stage; Zernike moments beside peers.

A touch is decoded, its rim found, its disc cut and standardised, and the disc
encoded. CPU time on one thread for one touch at a time, as a robot has them. Of
decoding a whole folder, each side runs in a process of its own, so that its peak of
memory is its own.

Every peer of Zernike moments gets what it can prepare beforehand for free: centrosome
its polynomials, the dense basis its matrix of the taxels inside the disc. mahotas
prepares nothing between images. Neither package takes several images at once, so beside
a batch stands their time for one image. mahotas drops taxels that are not positive: all
are here.
"""

import tempfile
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from joblib import cpu_count

from palpate._extras import missing
from palpate._image_estimator import inscribed_mask
from palpate._types import Array, Bools, Floats, Singles
from palpate.encodings import HuMoments, ZernikeMoments, encoder_named
from palpate.encodings._named import ENCODINGS
from palpate.encodings._zernike_tables import zernike_degrees, zernike_values
from palpate.images import DomeCrop

from . import (
    N_COLS,
    N_ROWS,
    Picture,
    Row,
    coded,
    cpu_ms,
    drawn_dome,
    measured_apart,
    one_thread,
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
from palpate import Touches
def work(folder): return Touches.load(folder, progress=False).images
"""
_PEER = """
from pathlib import Path
import numpy as np
from joblib import cpu_count
from PIL import Image
def work(folder): return np.stack([np.asarray(Image.open(p).convert('L'))
    for p in sorted(Path(folder).rglob('*.jpg'))])
"""
# What no reader of these files can do without: undoing their entropy code. An eighth of
# the size needs next to nothing else, and is neither kept nor checked.
_LEAST = """
from pathlib import Path
import numpy as np
import simplejpeg
small = dict(min_height=60, min_width=80, min_factor=8)
def work(folder): return np.stack([simplejpeg.decode_jpeg(p.read_bytes(), 'GRAY',
    **small) for p in sorted(Path(folder).rglob('*.jpg'))])
"""
Encode = Callable[[Array], Floats]
_TYPES = ("float64", "float32", "uint8")
_N_TOUCHES = 32  # pictures in turn, so that none stays in the cache
_SIZE = 128  # pixels of a disc


def bench_decode(
    data: str | Path | None = None, *, repeats: int = 3, n_pictures: int = 772
) -> list[Row]:
    """Measure reading a folder of 640 x 480 JPEGs beside a plain Pillow loop.

    Without real touches (`bathtip/originals`) `n_pictures` are drawn; the fastest of
    `repeats` counts. Rows have CPU and wall time and peaks of memory in MiB; the last
    one is what undoing the files' entropy code takes, which bounds all others.
    """
    real = real_touches(data)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        if real is None:
            rng = np.random.default_rng(0)
            pictures = [coded(drawn_dome(rng)) for _ in range(16)]
            for touch in range(n_pictures):
                picture = pictures[touch % len(pictures)]
                (folder / f"img_{touch}.jpg").write_bytes(picture)
        else:
            # Without the picture of no contact among them.
            originals = (real / "bathtip" / "originals").glob("*/*/*.jpg")
            for number, path in enumerate(sorted(originals)):
                (folder / f"img_{number}.jpg").symlink_to(path.resolve())
        # Once, so that neither side waits for the disk.
        for path in folder.iterdir():
            path.read_bytes()
        ours, peer, least = (
            measured_apart(_FRAME.format(work=work, repeats=repeats), folder)
            for work in (_OURS, _PEER, _LEAST)
        )
    size = f"{ours['n']:.0f} x {N_COLS} x {N_ROWS} uint8 JPEG"
    facts = {"n_cores": cpu_count(), "array_mib": ours["array_mib"]}
    facts |= {"peak_mib": ours["peak_mib"], "peak_before_mib": ours["before_mib"]}
    facts["peer_peak_mib"] = peer["peak_mib"]
    name = f"{size} {'drawn' if real is None else 'real'} folder"
    rows = [
        row(f"{name} {of}", ours[f"{of}_ms"], "Pillow loop", peer[f"{of}_ms"], **facts)
        for of in ("cpu", "wall")
    ]
    name = f"{name} an eighth of the size, the least cpu"
    return [*rows, row(name, least["cpu_ms"], "Pillow loop", peer["cpu_ms"])]


def bench_encodings(
    data: str | Path | None = None,
    *,
    seconds: float = 0.3,
    names: Sequence[str] = tuple(ENCODINGS),
) -> list[Row]:
    """Time each stage on its own, then each encoding, by default all there are.

    Rows of encodings hold `ours_ms` of encoding alone, `touch_ms` of crop, standardise
    and encode, and the share of each stage in per cent of everything.
    """
    real = real_touches(data)
    pictures, kind = _pictures(real), "drawn" if real is None else "real"
    with one_thread():
        stages, discs = _stages(pictures, seconds)
        rows = [
            row(f"640 x 480 {kind} {name}", ms, reason="a stage of ours")
            for name, ms in stages.items()
        ]
        if "hu" in names:
            rows.append(_hu_row(pictures, kind, seconds))
        setting = (kind, discs, stages, seconds)
        return rows + [_encoding_row(name, *setting) for name in names]


def bench_zernike(
    *,
    size: int = 300,
    order: int = 15,
    n_touches: int = 64,
    seconds: float = 0.5,
    random_state: int = 0,
) -> list[Row]:
    """Time an image of `size` taxels a side, alone and in a batch, all in float64."""
    rng = np.random.default_rng(random_state)
    grey = rng.integers(1, 256, size=(n_touches, size, size), dtype=np.uint8)
    rows = []
    with one_thread():
        peers = _peers(size, order)
        for dtype in _TYPES:
            images = grey.astype(dtype)

            def each_ms(encode: Encode, batch: Array) -> float:
                return cpu_ms(lambda: encode(batch), seconds) / len(batch)

            for batch, width in (
                (images[:1], "single"),
                (images, f"batch {n_touches}"),
            ):
                theirs = {
                    peer: {"peer_ms": each_ms(encode, batch[:limit])}
                    if encode
                    else {"reason": missing(peer, "bench", "A peer")}
                    for peer, (encode, limit) in peers.items()
                }
                for method in ("sample", "exact"):
                    encoder = ZernikeMoments(order, method=method).fit(batch[:1])
                    ours = each_ms(encoder.transform, batch)
                    name = f"{size} x {size} {dtype} {method} {width}"
                    rows += [row(name, ours, p, **peer) for p, peer in theirs.items()]
    return rows


def _stages(
    pictures: list[Picture], seconds: float
) -> tuple[dict[str, float], Singles]:
    """Return milliseconds of each stage before the encoding, and the discs."""
    images = np.stack([_decoded(picture) for picture in pictures])
    crop = DomeCrop(_SIZE, output="grey").fit(images)
    rims = crop.rims(images)
    discs = crop.cut(images, rims)
    stages: dict[str, Callable[[int], object]] = {
        "decoding": lambda i: _decoded(pictures[i]),
        "rim finding": lambda i: crop.rims(images[i : i + 1]),
        "cropping": lambda i: crop.cut(images[[i]], rims[i : i + 1]),
        "standardising": lambda i: DomeCrop.standardise(discs[i : i + 1]),
    }
    times = {name: _each(stage, seconds) for name, stage in stages.items()}
    return times, DomeCrop.standardise(discs)


def _decoded(picture: Picture) -> Array:
    image = cv2.imdecode(picture, cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise ValueError("Pictures must be decodable, got one that is not.")
    return image


def _encoding_row(
    name: str, kind: str, discs: Singles, stages: dict[str, float], seconds: float
) -> Row:
    encoder = encoder_named(name).fit(discs)
    encode = _each(lambda i: encoder.transform(discs[i : i + 1]), seconds)
    crop = stages["cropping"] + stages["standardising"]
    parts = {"decode": stages["decoding"], "rim": stages["rim finding"]}
    parts |= {"crop": crop, "encode": encode}
    shares = {f"share_{p}": 100 * ms / sum(parts.values()) for p, ms in parts.items()}
    facts = {**_peer(name, discs, seconds), "touch_ms": crop + encode, **shares}
    return row(f"640 x 480 {kind} encoding {name}", encode, **facts)


def _hu_row(pictures: list[Picture], kind: str, seconds: float) -> Row:
    """Time Hu's moments of the disc of a picture; OpenCV takes no least level off."""
    images = np.stack([_decoded(picture) for picture in pictures])
    encoder = HuMoments().fit(images[:1])
    disc = np.where(inscribed_mask(*images.shape[1:]), 255, 0).astype(np.uint8)
    ours = _each(lambda i: encoder.transform(images[i : i + 1]), seconds)
    peer = _each(
        lambda i: cv2.HuMoments(cv2.moments(cv2.bitwise_and(images[i], disc))), seconds
    )
    return row(f"640 x 480 {kind} disc of a picture hu", ours, "OpenCV", peer)


def _peer(name: str, discs: Singles, seconds: float) -> dict[str, Any]:
    """Time the same encoding by another package, on discs of positive levels."""
    if name == "hu":
        ms = _each(lambda i: cv2.HuMoments(cv2.moments(discs[i])), seconds)
        return {"peer": "OpenCV", "peer_ms": ms}
    if name != "zernike":
        return {"reason": "no package has it"}
    if find_spec("mahotas") is None:
        return {"peer": "mahotas", "reason": missing("mahotas", "bench", "A peer")}
    encode, lit = _mahotas(discs.shape[1], 15), discs - discs.min() + 1
    ms = _each(lambda i: encode(lit[i : i + 1]), seconds)
    return {"peer": "mahotas", "peer_ms": ms}


def _each(function: Callable[[int], object], seconds: float) -> float:
    """Return milliseconds for one touch, taking turns among all."""
    whole_ms = cpu_ms(lambda: [function(i) for i in range(_N_TOUCHES)], seconds)
    return whole_ms / _N_TOUCHES


def _pictures(data: Path | None) -> list[Picture]:
    """Return coded JPEGs: real ones spread over the objects, or drawn ones."""
    if data is None:
        drawn = [drawn_dome(np.random.default_rng(n)) for n in range(_N_TOUCHES)]
        return [np.frombuffer(coded(image), np.uint8) for image in drawn]
    paths = sorted((data / "bathtip" / "originals").glob("*/*/*.jpg"))
    if len(paths) < _N_TOUCHES:
        raise ValueError(
            f"data must hold {_N_TOUCHES} pictures in bathtip/originals, got "
            f"{len(paths)} in {data}. Unset PALPATE_DATA to draw some."
        )
    spread = np.linspace(0, len(paths) - 1, _N_TOUCHES).astype(int)
    return [np.frombuffer(paths[i].read_bytes(), np.uint8) for i in spread]


def _peers(size: int, order: int) -> dict[str, tuple[Encode | None, int | None]]:
    """Return how each peer encodes, None where absent, and how many images it takes."""
    makers = {"mahotas": _mahotas, "centrosome": _centrosome}
    return {
        **{n: (m(size, order) if find_spec(n) else None, 1) for n, m in makers.items()},
        "dense basis": (dense_basis(size, order), None),
    }


def _mahotas(size: int, order: int) -> Encode:
    from mahotas.features import zernike_moments

    centre = ((size - 1) / 2, (size - 1) / 2)
    return lambda images: zernike_moments(images[0], size / 2, order, cm=centre)


def _centrosome(size: int, order: int) -> Encode:
    from centrosome.zernike import construct_zernike_polynomials

    x, y, inside = _disc(size)
    degrees = np.array(zernike_degrees(order))
    values = construct_zernike_polynomials(x[inside], y[inside], degrees)
    scale = (degrees[:, 0] + 1) / np.pi * (2 / size) ** 2

    def encode(images: Array) -> Floats:
        levels = images[0][inside].astype(np.float64)
        return np.asarray(np.abs((levels[:, None] * values).sum(axis=0)) * scale)

    return encode


def dense_basis(size: int, order: int) -> Encode:
    """Encode by a matrix product with the polynomials at taxel centres in the disc."""
    x, y, inside = _disc(size)
    degrees = np.array(zernike_degrees(order))
    taxels = np.flatnonzero(inside)
    waves = degrees[:, 1] > 0
    values = np.stack(list(zernike_values(order, x[inside], y[inside])), axis=1)
    basis = np.concatenate([values.real, values.imag[:, waves]], axis=1)
    scale = (degrees[:, 0] + 1) / np.pi * (2 / size) ** 2

    def encode(images: Array) -> Floats:
        levels = images.reshape(len(images), -1).take(taxels, axis=1)
        parts = levels.astype(np.float64, copy=False) @ basis
        sizes = np.abs(parts[:, : len(degrees)])
        sizes[:, waves] = np.hypot(sizes[:, waves], parts[:, len(degrees) :])
        return np.asarray(sizes * scale)

    return encode


def _disc(size: int) -> tuple[Floats, Floats, Bools]:
    """Return taxel centres x and y, in radii, and which lie in the inscribed disc."""
    side = (2 * np.arange(size) + 1 - size) / size
    x, y = np.meshgrid(side, side)
    return x, y, np.hypot(x, y) <= 1
