"""Commands that cannot be done: an exit code, one sentence, and no file.

They are called where a dome's model, m.palpate, lies beside its touches, m.npz, and a
library, lib, of touches of a ball, a mug and a pen.
"""

import json
import shlex
import shutil

import pytest

from palpate.web import PageServer

MISSPELT = "library ('ball', 'mug', 'pen'), got {!r}. Did you mean 'mug'?".format
TURNED = "MODEL must come first, then TOUCHES, got m.npz"
TOO_LARGE = "A model file must be at most 0.001 MB large"
REFUSED = {
    "learn": [
        ("", 2, "Missing argument"),
        ("gone -o n.palpate", 1, "gone"),
        ("gone -o n.pkl", 1, "must end in .palpate"),
    ],
    "learn m.npz -o n.palpate": [
        ("--workers 0", 2, "--workers must be at least 1"),
        ("--workers 2 --cluster x", 1, "either --workers or --cluster"),
        ("--where 'object = pen'", 1, "make one with `palpate library add`"),
        ("--extend m.palpate --max-model-mb 1e-3", 1, TOO_LARGE),
    ],
    "learn lib -o n.palpate": [
        ("--where 'object = mgu'", 1, MISSPELT("mgu")),
        ("--where 'order = 99'", 1, "See `palpate library list`, and widen the filter"),
        ("--where 'colour = red'", 1, "must name columns of the library"),
        ("--name-pattern x", 1, "--name-pattern must be left out for a library"),
        ("--colour", 1, "--colour must be left out for a library"),
    ],
    "evaluate --train m.npz": [
        ("--touches a", 2, "--touches 1,5,15"),
        ("--error 5%", 2, "--error must be a number such as 0.01, got '5%'."),
        ("--error=5%", 2, "--error must be a number such as 0.01, got '5%'."),
        ("--orders 2.5", 2, "--orders must be a whole number such as 20, got '2.5'."),
    ],
    "evaluate --train lib --split last": [
        ("--where 'object = mgu'", 1, MISSPELT("mgu")),
        ("--test-where 'a > 3'", 1, "--test-where must come with --test, got 'a > 3'"),
        (
            "--unknown-where 'a > 3'",
            1,
            "--unknown-where must come with --unknown, got 'a > 3' alone",
        ),
    ],
    "benchmark m.npz": [
        ("--touches few", 2, "--touches must be whole numbers"),
        ("--workers 0", 2, "--workers must be at least 1"),
    ],
    "check lib": [
        ("--shape=2x2", 1, "--shape must be left out for a library"),
        ("--dtype=<u2", 1, "--dtype must be left out for a library"),
        ("--channels=x,y", 1, "--channels must be left out for a library"),
        ("--begin=3", 1, "--begin must be left out for a library"),
    ],
    "check m.npz": [
        ("--report gone/x.html", 1, "There is no folder gone to write to; make it."),
        ("--begin 3", 1, "--begin must be left out for"),
        ("--max-megapixels inf", 1, "--max-megapixels must be positive and finite"),
        ("--max-megapixels nan", 1, "--max-megapixels must be positive and finite"),
        ("--max-megapixels -1", 1, "--max-megapixels must be positive and finite"),
    ],
    "": [
        ("touch", 2, "No such command"),
        ("bench speed", 1, "'zernike'"),
        ("recognise gone.palpate gone.npz", 1, "no model file gone.palpate"),
        ("recognise m.npz m.palpate", 2, TURNED),
        ("remount m.npz m.palpate -o n.palpate", 2, TURNED),
        ("sensor learn-nuisance m.npz m.palpate -o n.palpate", 2, TURNED),
        ("recognise m.palpate m.npz --max-model-mb 1e-3", 1, TOO_LARGE),
        ("remount m.palpate m.npz -o n.palpate --max-model-mb 1e-3", 1, TOO_LARGE),
        ("explore recognise m.palpate mug --max-model-mb 1e-3", 1, TOO_LARGE),
        ("live m.palpate --sensor sim:bar10 --max-model-mb 1e-3", 1, TOO_LARGE),
        ("serve --model m.palpate --port 0 --max-model-mb 1e-3", 1, TOO_LARGE),
        ("demo --real", 1, "PALPATE_DATA"),
        ("demo --strangers 2", 1, "--strangers must be finite and between 0 and 1"),
    ],
    "simulate array": [
        ("", 2, "Missing option"),
        ("-o t.npy", 2, "must end in .npz"),
        ("-o gone/t.npz", 1, "no folder gone"),
        ("-o t.npz --load heavy", 1, "--load 1:5"),
        ("-o t.npz --sensing 3", 1, "at most pitch_mm"),
        ("-o t.npz --workers 0", 2, "--workers must be at least 1, or -1"),
        ("-o t.npz --pitch 1e6", 1, "--pitch must make at most"),
        ("--pitch 1e6 -o t.npz", 1, "Lower --pitch or"),
        ("-o t.npz --rows 100000", 1, "number of taxels (--rows, --cols)"),
        ("-o t.npz --seed -1", 2, "--seed must be between 0 and 4294967295"),
    ],
    "simulate": [
        ("dome -o t.txt", 2, "must end in .npz"),
        ("dome -o gone/t.npz", 1, "no folder gone"),
        ("dome -o t.npz spoon", 1, "got 'spoon'"),
        ("dome -o t.npz gone.stl", 1, "got no file 'gone.stl'. Check its name"),
        ("dome -o t.npz mug mug", 1, "got 'mug' as 'mug' and 'mug'"),
        ("dome -o t.npz mug edge", 1, "archives of their own"),
        ("dome -o t.npz mug --force -1", 1, "--force must be positive"),
        ("dome -o t.npz --rows 100000", 1, "100000 x 120. Take fewer rows"),
        ("dome -o t.npz --workers 0", 2, "all cores, got 0."),
        ("pins -o t.npz --workers -2", 2, "all cores, got -2."),
        ("pins -o t.npz --seed 4294967296", 2, "4294967295, got 4294967296"),
        ("pins -o t.npz household mug", 1, "'mug' as 'household' and 'mug'"),
        ("pins -o t.npz mug --touches 0", 1, "at least 1, got 0"),
    ],
    "explore learn": [
        ("pen -o n.palpate", 1, "at least 2 objects"),
        ("pen spoon -o n.palpate", 1, "got 'spoon'"),
        ("pen pen -o n.palpate", 1, "'pen' as 'pen' and 'pen'"),
        ("pen ball -o n.txt", 1, "must end in .palpate"),
        ("pen ball -o n.palpate --workers 0", 2, "cores, got 0"),
        ("pen ball -o n.palpate --seed -1", 2, "--seed must be"),
        ("pen ball -o n.palpate --rows 100000", 1, "fewer rows and columns"),
        ("pen ball -o n.palpate --folder m.npz", 1, "file 'm.npz'. Use another folder"),
        (
            "pen nothing -o n.palpate --workers 1 --rows 24 --touches 3",
            1,
            "Only 0 of 1 touches",
        ),
    ],
    "explore recognise": [
        ("gone.palpate ball", 1, "no model file gone.palpate"),
        ("m.palpate household", 1, "got the set 'household'"),
        ("m.palpate gone.stl", 1, "got no file 'gone.stl'"),
        ("m.palpate ball --folder m.npz", 1, "file 'm.npz'. Use another folder"),
        ("m.palpate ball --seed -1", 2, "got -1. Give another"),
        ("m.palpate ball --strategy best", 2, "'informative'"),
        ("m.palpate ball --fault x", 1, "NUMBER=NAME"),
        ("m.palpate ball --fault ²=slow", 1, "NUMBER=NAME"),
        ("m.palpate ball --fault 0=x", 1, "'stuck force'"),
        ("m.palpate ball --picture no/a.png", 1, "no folder no"),
        ("m.palpate ball --picture a.txt", 2, "must end in .png"),
        ("m.palpate ball --face 9", 1, "face must be below"),
        ("m.palpate ball --taught gone.npz", 1, "gone.npz"),
    ],
    "sensor check --sensor sim:bar10": [
        ("--report x.pdf", 2, "must end in .html"),
        ("--seconds 300 --report gone/x.html", 1, "no folder gone to write to; make"),
        ("--seconds 0", 1, "seconds must be"),
    ],
    "record x --library l --sensor": [
        ("telepathy", 2, "camera:NAME"),
        ("camera:0?baud=9", 2, "'baud' is no option"),
        ("sim:mug --colour", 2, "--colour must be left out: a sim sensor"),
        ("camera:0?colour=0 --colour", 2, "colour=no in 'camera:0?col"),
        ("sim:bar10?shape=4x4", 2, "10 x 10, got 4 x 4. Leave --shape out."),
        ("sim:mug?rate=3 --rate 4", 2, "in 'sim:mug?rate=3' and --rate 4.0 contradict"),
        ("serial:/dev/x", 2, "or --shape 16x16; --shape auto listens to it."),
        ("serial:x?checksum=no --checksum", 2, "=no' and --checksum contradict"),
        ("serial:x?checksum=yes --no-checksum", 2, "and --no-checksum contradict each"),
        ("serial:/dev/nowhere --shape 4x4", 1, "cannot be opened"),
        ("camera:/dev/nowhere", 1, "no camera at"),
        ("sim:mug -o gone/a.npz", 1, "There is no folder gone to write to; make it."),
        ("sim:mug -n 0", 1, "--touches must be at least 1, got 0"),
        ("sim:mug -n 1001", 1, "--touches must be at most 1000, got 1001"),
        ("sim:mug -n 1 --sessions 2", 1, "--touches must be at least one for each of"),
        ("sim:mug --timeout inf", 1, "--timeout must be finite and between 0"),
        ("sim:mug --timeout nan", 1, "--timeout must be finite and between 0"),
    ],
    "record --library l --sensor sim:mug": [
        ("' '", 1, "The name of an object must"),
        ("unknown", 1, "The name of an object must"),
        ("x" * 100, 1, "The name of an object must"),
    ],
    "live m.palpate --sensor sim:mug": [
        ("--episodes=-1", 1, "--episodes must be at least 0, got -1"),
        ("--touches=0", 1, "--touches must be at least 1, got 0"),
        ("--timeout=inf", 1, "--timeout must be finite and between 0"),
    ],
    "serve --library l --port 0 --sensor": [
        ("camera:/dev/nowhere", 1, "no camera at"),
        ("serial:/dev/nowhere --shape 4x4", 1, "cannot be opened"),
        ("serial:/dev/x --rate 9", 2, "--rate must be left out"),
        ("sim:bar10 --shape 4x4", 2, "10 x 10, got 4 x 4"),
        ("sim:mug --port 99999", 1, "0 to 65535, got 99999"),
        ("sim:mug --port -1", 1, "0 to 65535, got -1"),
    ],
    "library": [
        ("rename lib mgu cup", 1, MISSPELT("mgu")),
        ("merge lib pen mugg", 1, MISSPELT("mugg")),
        ("retract lib 'object = Mugs' --reason wet", 1, MISSPELT("Mugs")),
        ("restore lib --where 'order < 3 and (object=mgu)'", 1, MISSPELT("mgu")),
        ("export lib -o x.npz --where 'object = mgu'", 1, MISSPELT("mgu")),
        ("list lib --where \"object == 'mgu'\"", 1, MISSPELT("mgu")),
        ("list lib --where 'objekt = 3'", 1, "--where must name columns"),
        ("list lib --where 'order = ('", 1, "--where must go on"),
        ("list lib --objects --where 'object = mug'", 1, "must stand without --where"),
        ("list lib --objects --offset 1", 1, "--objects must stand without --where"),
        ("list lib --objects --retracted", 1, "--objects must stand without --where"),
        ("show lib abc -o gone/a.npy", 1, "no folder gone to write to; make it."),
        ("show lib abc -o a.npz", 2, "--output must end in .npy, got 'a.npz'."),
        ("list gone", 1, "Make one with `palpate library add`."),
        ("add l m.npz -n 12", 1, "--touches must be left out without a running sensor"),
        (
            "add l ros:/pad?domain=3",
            1,
            "--object NAME must be given with a running sensor",
        ),
    ],
    "library add l sim:mug --object x": [
        ("-n 0", 1, "--touches must be at least 1, got 0"),
        ("-n 1001", 1, "--touches must be at most 1000, got 1001"),
        ("--colour", 1, "--colour must be left out with a running sensor"),
        ("--shape 4x4", 1, "--shape must be left out with a running sensor"),
        ("--detect", 1, "--detect must be left out with a running sensor"),
        ("--episode e", 1, "--episode must be left out with a running sensor"),
        ("--skip-bad", 1, "--skip-bad must be left out with a running sensor"),
    ],
    "library add l . --topic /pad": [
        (f"--{name} x", 1, f"--{name} must be left out for a bag such as ., got 'x'")
        for name in ("where", "name-pattern", "no-contact")
    ],
}
CASES = [
    pytest.param(f"{verb} {words}", code, message, id=f"{verb} {words}")
    for verb, refusals in REFUSED.items()
    for words, code, message in refusals
]


@pytest.mark.parametrize(("words", "code", "message"), CASES)
def test_a_refused_command_says_what_to_do_and_leaves_no_file(
    palpate, explored, tmp_path, monkeypatch, words, code, message
):
    monkeypatch.setenv("COLUMNS", "400")
    monkeypatch.delenv("PALPATE_DATA", raising=False)
    monkeypatch.setattr(PageServer, "run", lambda server, app: None)
    here = shutil.copytree(explored, tmp_path / "here")
    result = palpate(*shlex.split(words), cwd=here)
    starting = "Starting; the address follows.\n" * ("serve" in words.split())
    assert (result.returncode, result.stdout) == (code, starting)
    assert message in result.stderr
    as_json = palpate(*shlex.split(words), "--json", cwd=here)
    assert as_json.returncode == code
    assert list(answer := json.loads(as_json.stdout)) == ["error"]
    assert message in answer["error"]
    assert as_json.stderr == f"palpate: {answer['error']}\n"
    assert sorted(path.name for path in here.iterdir()) == ["lib", "m.npz", "m.palpate"]
