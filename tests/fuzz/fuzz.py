"""A standing campaign: input from outside, changed by chance, seed after seed.

`python tests/fuzz/fuzz.py --seconds 60` goes on where the last run stopped, as its file
`.fuzz-seeds.json` says. A failure is printed with the kind and the seed that make it
again (`--kind model --seed 17`), and ends the run with exit code 1.
"""

import argparse
import atexit
import io
import json
import random
import tempfile
import time
import traceback
import warnings
import zipfile
from collections import Counter
from functools import cache, partial
from pathlib import Path

import numpy as np
from forged_models import forged, models, mutated, opened
from machines import MACHINES, play, recognisers
from PIL import Image

from palpate import ObjectRecogniser, Touches
from palpate.library import LibraryError, read_bag
from palpate.recognition import ModelFileError
from palpate.sensors import BinaryFraming, LineFraming
from palpate.touches import TouchesError, decode_bytes

HERE = Path(__file__).parent
CORPUS = HERE / "corpus"
SLOWEST_S = 5.0


def changed(data, chance):
    """Return the bytes with one to four places changed."""
    data = bytearray(data)
    for _ in range(chance.choice([1, 1, 2, 4])):
        at, n = chance.randrange(len(data) + 1), chance.choice([1, 2, 4, 64])
        kind = chance.randrange(5)
        if kind == 0 and at < len(data):
            data[at] ^= 1 << chance.randrange(8)
        elif kind == 1:
            data[at : at + n] = chance.choice([b"\0", b"\xff", b"\x7f"]) * n
        elif kind == 2:
            del data[at : at + n]
        elif kind == 3:
            data[at:at] = data[at : at + n]
        else:
            del data[at:]
    return bytes(data)


@cache
def saved_models():
    folder = Path(tempfile.mkdtemp())
    return [opened(recogniser.save(folder / "m.palpate")) for recogniser in models()]


def model(chance, folder):
    """A model with a right checksum is refused by our own error, or recognises."""
    document, tensors = mutated(*chance.choice(saved_models()), chance.random())
    path = forged(folder / "m.palpate", document, tensors)
    try:
        recogniser = ObjectRecogniser.load(path)
        blank = recogniser.encoder_.blank_touch()
    except ModelFileError:
        return "refused"
    with np.errstate(all="ignore"):  # numbers up to 1e308 may come to their limits
        belief = recogniser.start().update(blank)
    assert np.isfinite([belief.unknown, *belief.posterior.values()]).all()
    return "read"


@cache
def archive_members():
    images = np.random.default_rng(0).integers(0, 255, (6, 4, 5), dtype=np.uint8)
    touches = Touches(
        images, object=["a"] * 3 + ["b"] * 3, force_n=np.arange(6.0), session=["s"] * 6
    )
    path = Path(tempfile.mkdtemp()) / "t.npz"
    touches.save(path)
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def archive(chance, folder):
    """A touch archive whose arrays or headers were changed, with right CRCs."""
    members = dict(archive_members())
    name = chance.choice(sorted(members))
    kind = chance.randrange(4)
    if kind == 0:
        members[name] = changed(members[name], chance)
    elif kind == 1:
        members[name] = members[chance.choice(sorted(members))]
    elif kind == 2:
        members[chance.choice(["pads.npy", "channels.npy", "x.npy"])] = members[name]
    else:
        old, new = chance.choice(
            [(b"(6,", b"(9,"), (b"|u1", b"<f8"), (b"<f8", b"|O8"), (b"False", b"True ")]
        )
        members[name] = members[name].replace(old, new)
    path = folder / "t.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for member, content in members.items():
            archive.writestr(member, content)
    if chance.random() < 0.2:
        path.write_bytes(changed(path.read_bytes(), chance))
    try:
        len(Touches.load(path))
    except TouchesError:
        return "refused"
    return "read"


@cache
def pictures():
    levels = np.random.default_rng(0).integers(0, 255, (24, 32), dtype=np.uint8)
    encoded = []
    for mode, kind in (("L", "JPEG"), ("RGB", "JPEG"), ("L", "PNG"), ("P", "PNG")):
        stream = io.BytesIO()
        picture = Image.fromarray(levels)
        options = {"progressive": True} if mode == "RGB" else {}
        picture.convert(mode).save(stream, kind, **options)
        encoded.append(stream.getvalue())
    return encoded + [path.read_bytes() for path in sorted(CORPUS.glob("picture-*"))]


def picture(chance, folder):
    """A picture is refused by our own error, or decoded to its own size."""
    try:
        levels = decode_bytes(changed(chance.choice(pictures()), chance))
    except TouchesError:
        return "refused"
    assert levels.ndim == 2, levels.shape
    return "read"


def bag(chance, folder):
    """A bag with odd messages or changed bytes is refused, or read as it stands."""
    import forged_bags

    path = forged_bags.bag(chance, folder)
    if chance.random() < 0.4:
        file = chance.choice(sorted(path.iterdir()))
        file.write_bytes(changed(file.read_bytes(), chance))
    if chance.random() < 0.3:
        path = chance.choice(sorted(path.iterdir()))
    try:
        touches = read_bag(path, "/pad", max_bytes=10**7)
    except (LibraryError, TouchesError):
        return "refused"
    assert len(touches) == len(touches.columns["time_s"])
    return "read"


def message(chance, folder):
    """Frames of a serial array, changed and cut anywhere, never end the stream."""
    image = np.arange(12, dtype=np.uint16).reshape(3, 4)
    framing = chance.choice([LineFraming((3, 4)), BinaryFraming((3, 4))])
    data = changed(framing.write(image) * 20, chance) + framing.write(image) * 3
    frames = []
    while data:
        n = chance.randint(1, 70)
        frames += framing.feed(data[:n])
        data = data[n:]
    assert all(frame.shape == (3, 4) for frame in frames)
    assert frames, "nothing was read after the damage"
    np.testing.assert_array_equal(frames[-1], image)
    return "read"


@cache
def learnt_patterns():
    rng = np.random.default_rng(0)
    patterns = {name: rng.normal(size=(3, 8)) for name in "abcd"}
    start = Touches(
        np.concatenate([drawn(patterns[n], rng, 4) for n in "ab"]),
        object=np.repeat(["a", "b"], 4),
        geometry="none",
    )
    return patterns, ObjectRecogniser().fit(start)


def drawn(pattern, rng, n_touches):
    """Return noisy touches of one pattern."""
    return pattern + 0.3 * rng.normal(size=(n_touches, *pattern.shape))


def learning(chance, folder):
    """Learning, forgetting and touching in any order keep a belief a belief."""
    patterns, recogniser = learnt_patterns()
    rng = np.random.default_rng(chance.randrange(2**32))
    recogniser.save(folder / "b.palpate")
    recogniser = ObjectRecogniser.load(folder / "b.palpate")
    names, belief = {"a", "b"}, recogniser.start()
    for _ in range(8):
        name = chance.choice("abcd")
        touches = Touches(drawn(patterns[name], rng, 3), geometry="none")
        step = chance.choice(["learn", "forget", "touch", "touch", "touch", "end"])
        if step == "learn":
            learn = recogniser.extend_object if name in names else recogniser.add_object
            learn(name, touches)
            names.add(name)
        elif step == "forget" and name in names and len(names) > 2:
            recogniser.forget_object(name)
            names.discard(name)
        elif step == "touch":
            belief.update(touches[: chance.randint(1, 3)])
            assert abs(sum(belief.posterior.values()) + belief.unknown - 1) < 1e-9
            assert 0 <= belief.unknown <= 1
            assert belief.decide() in (*belief.posterior, "unknown", None)
            continue
        belief = recogniser.start()
        assert set(belief.posterior) == names
    return "kept"


@cache
def client():
    import httpx

    from palpate.web import LiveSession, PageServer, create_app

    session = LiveSession(None, library=Path(tempfile.mkdtemp()) / "library").start()
    served = PageServer().running(create_app(session, "token"), log_level="error")
    address = served.__enter__()
    atexit.register(served.__exit__, None, None, None)
    headers = {"Authorization": "Bearer token"}
    return httpx.Client(base_url=address, headers=headers, timeout=30)


def answered(*order, **parts):
    """Return the answer to an order, asked again after a while where it is too fast."""
    while (answer := client().request(*order, **parts)).status_code == 429:
        time.sleep(float(answer.headers["Retry-After"]))
    return answer


def http(chance, folder):
    """Commands in any order, some damaged, are answered, never by a server error."""
    image = [[chance.randint(0, 255) for _ in range(4)] for _ in range(4)]
    orders = [
        ("touch", {"image": image}),
        ("teach/touch", {"image": image, "object": chance.choice("ab")}),
        ("teach", {"object": chance.choice("ab")}),
        ("episode/start", {}),
        ("episode/end", {}),
        ("teach/undo", {}),
        ("objects/rename", {"object": "a", "name": chance.choice("bc")}),
        ("objects/forget", {"object": chance.choice("abc")}),
        ("baseline", {"frames": chance.choice([1, -1, 10**9, "x", None])}),
    ]
    for _ in range(6):
        path, body = chance.choice(orders)
        data = json.dumps(body).encode()
        if chance.random() < 0.6:
            data = changed(data, chance)
        kind = chance.choice(["application/json", "application/json", "text/plain"])
        headers = {"Content-Type": kind}
        answer = answered("POST", f"/api/{path}", content=data, headers=headers)
        assert answer.status_code < 500, (path, data, answer.text)
        assert answered("GET", "/api/state").status_code == 200
    return "answered"


def played(name, chance, folder):
    """Play a state machine: orders in any sequence, beside its reference."""
    play(MACHINES[name], chance.randrange(2**32), 5)
    return "kept"


_KINDS = (model, archive, picture, bag, message, learning, http)
KINDS = {kind.__name__: kind for kind in _KINDS}
KINDS |= {name: partial(played, name) for name in MACHINES}

# Caches that are filled before the time of an input is measured.
PREPARATIONS = {
    "model": saved_models,
    "learning": learnt_patterns,
    "belief": recognisers,
    "http": client,
}


def tried(kind, seed):
    """Try one input of one kind; return its outcome, or raise."""
    chance = random.Random(f"{kind} {seed}")
    PREPARATIONS.get(kind, int)()
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("error")
        return KINDS[kind](chance, Path(folder))


def main():
    """Try inputs of all kinds until the time is over; return how many failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--kind", choices=sorted(KINDS))
    parser.add_argument("--seed", type=int)
    parser.add_argument("--file", type=Path, default=Path(".fuzz-seeds.json"))
    options = parser.parse_args()
    kinds = [options.kind] if options.kind else list(KINDS)
    if options.seed is not None:
        for kind in kinds:
            print(kind, options.seed, tried(kind, options.seed))
        return 0
    following = json.loads(options.file.read_text()) if options.file.exists() else {}
    outcomes, failures = {kind: Counter() for kind in kinds}, 0
    for kind in kinds:
        PREPARATIONS.get(kind, int)()
    end = time.monotonic() + options.seconds
    while time.monotonic() < end:
        for kind in kinds:
            share = time.monotonic() + options.seconds / 20 / len(kinds)
            while time.monotonic() < min(share, end):
                seed = following.get(kind, 0)
                following[kind] = seed + 1
                start = time.process_time()
                try:
                    outcomes[kind][tried(kind, seed)] += 1
                    assert time.process_time() - start < SLOWEST_S, "too slow"
                except Exception:
                    failures += 1
                    outcomes[kind]["FAILED"] += 1
                    print(f"FAILED: --kind {kind} --seed {seed}")
                    print(traceback.format_exc(limit=-3))
        options.file.write_text(json.dumps(following))
    for kind, counts in outcomes.items():
        print(f"{kind:9} seeds to {following.get(kind, 0):6}", dict(counts))
    return failures


if __name__ == "__main__":
    raise SystemExit(bool(main()))
