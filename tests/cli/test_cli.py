"""The command line from outside: JSON, exit codes, and one sentence per failure."""

import json
import os
import re
import subprocess
import sys
import tomllib
from importlib import import_module, metadata
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import typer

import palpate as package
from palpate import Touches
from palpate.cli import app
from palpate.cli.recognise import outcome_lines, print_episode
from palpate.library import TouchLibrary
from palpate.recognition import Belief, ObjectRecogniser
from palpate.web import LiveSession

from .conftest import NAMES, put, put_each

ROOT = Path(__file__).parents[2]


def commands():
    """Every command there is, as the words to type, with what Typer knows of it."""
    waiting = [((), typer.main.get_command(app))]
    while waiting:
        words, command = waiting.pop()
        below = getattr(command, "commands", {})
        waiting += [((*words, name), inner) for name, inner in below.items()]
        if not below:
            yield words, command


COMMANDS = sorted(words for words, _ in commands())


def test_learn_writes_a_model_that_recognises(palpate, archive, tmp_path):
    learnt = palpate.answer("learn", archive, "-o", tmp_path / "m.palpate")
    assert learnt["n_labels"] == 3
    assert ObjectRecogniser.load(learnt["model"]).classes_.tolist() == list(NAMES)


def test_learn_warns_of_few_objects_as_the_page_does(palpate, tmp_path):
    images = np.random.default_rng(0).normal(size=(60, 3, 24))
    names = np.repeat([f"thing {n}" for n in range(6)], 10)
    kinds = np.repeat(["odd", "even"], 30)
    labels = {"object": names, "category": kinds, "geometry": "none"}
    six = Touches(images, **labels)
    file, model = tmp_path / "t.npz", tmp_path / "m.palpate"
    six[:50].save(file)
    lines = palpate.printed("learn", file, "-o", model).splitlines()
    (warning,) = [line for line in lines if line.startswith("It knows")]
    assert warning.startswith("It knows 5 objects and nothing else: ")
    assert LiveSession(model=model).episode.limits == warning
    six.save(file)
    assert "It knows" not in palpate.printed("learn", file, "-o", model)
    printed = palpate.printed("learn", file, "-o", model, "--label", "category")
    assert "It knows 2 categories and nothing else: " in printed


def test_recognise_gives_one_episode_per_object(palpate, archive, model):
    episodes = palpate.answer("recognise", model, archive)["episodes"]
    assert [e["object"] for e in episodes] == list(NAMES)
    for episode in episodes:
        assert [b["touch"] for b in episode["beliefs"]] == list(range(1, 21))
        for belief in episode["beliefs"]:
            known_probability = sum(belief["posterior"].values())
            assert known_probability + belief["unknown"] == pytest.approx(1)
            assert 0 <= belief["unknown"] <= 1
        assert episode["decision"] == episode["object"]
        assert 1 <= episode["touches_used"] <= 20
        assert episode["reasons"]


def test_recognise_takes_a_refusal_and_a_level(palpate, archive, model):
    options = ["--error", "0.05", "--refusal", "0.2", "--level", "any"]
    for episode in palpate.answer("recognise", model, archive, *options)["episodes"]:
        assert (episode["decision"], episode["level"]) == (episode["object"], "object")
        assert episode["promise"]["level"] == 0.05
        assert episode["promise"]["n_units"] == 3
    refused = palpate.refusal("recognise", model, archive, "--level", "category")
    assert "--level must be 'object' or 'any', got 'category'" in refused
    assert "the objects have none" in refused


@pytest.mark.parametrize("level", ["object", "any"])
def test_only_what_is_named_has_a_level(palpate, archive, model, monkeypatch, level):
    plain = Belief.named

    def named(self, *arguments, **options):
        decision = plain(self, *arguments, **options)
        if decision is None or self.best == NAMES[2]:
            return None
        return decision._replace(level="unknown", name="unknown")

    monkeypatch.setattr(Belief, "named", named)
    episodes = palpate.answer("recognise", model, archive, "--level", level)["episodes"]
    decisions = [(e["decision"], e["level"]) for e in episodes]
    assert decisions == [("unknown", None), ("unknown", None), (None, None)]


def test_recognise_draws_the_belief_for_people(palpate, archive, model):
    printed = palpate.printed("recognise", model, archive)
    assert "Touches of mug:" in printed
    assert "touch   1" in printed
    assert "█" in printed


def test_recognise_counts_how_labelled_episodes_ended():
    """A thing never learnt is rightly unknown; a learnt one alone needs no count."""
    ended = [("mug", "mug"), ("mug", "mug"), ("pen", "mug"), ("pen", None)]
    ended += [("box", "unknown"), ("box", "mug"), ("mug", "unknown")]
    episodes = [{"object": name, "decision": decision} for name, decision in ended]
    assert outcome_lines(episodes, ["mug", "pen"]) == [
        (
            "5 episodes of things learnt: 2 named right, 1 named wrong, 1 undecided, "
            "1 called unknown."
        ),
        "2 episodes of things never learnt: 1 called unknown, 1 named wrong.",
    ]
    assert outcome_lines(episodes[:1], ["mug"]) == []
    (stranger,) = outcome_lines(episodes[4:5], ["mug"])
    assert stranger == "1 episode of things never learnt: 1 called unknown."
    assert outcome_lines([{"object": None, "decision": "mug"}] * 2, ["mug"]) == []


@pytest.fixture
def printed(capsys):
    """Return the lines that are printed of an episode; touch 3 is of nothing."""

    def lines(n_touches):
        beliefs = [
            {"touch": n, "flag": "no contact" * (n == 3), "unknown": 0.1}
            | {"posterior": {"mug": 0.6, "pen": 0.3}}
            for n in range(1, n_touches + 1)
        ]
        episode = {"object": "mug", "beliefs": beliefs, "touches_used": n_touches}
        print_episode({**episode, "reasons": ["mug"], "withdrawn": [], "why": []})
        return capsys.readouterr().out.splitlines()

    return lines


def test_a_touch_without_contact_has_no_bar(printed):
    assert printed(14)[3] == "  touch 3: no contact, not counted"


@pytest.mark.parametrize("used", range(1, 40))
def test_touches_left_out_are_dots_which_never_stand_for_one(printed, used):
    """Each of the first touches, fewer later, the last."""
    numbers, gaps = [0], []
    for line in printed(used)[1:-2]:
        if line.strip() == "...":
            gaps.append(numbers[-1])
        else:
            numbers.append(int(re.search(r"touch +(\d+)", line)[1]))
    assert numbers[-1] == used
    assert gaps == [n for n, after in pairwise(numbers) if after > n + 1]
    assert all(after - before != 2 for before, after in pairwise(numbers))
    assert bool(gaps) == (used > 7)


def test_a_split_by_session_needs_sessions_and_says_how(palpate, archive):
    result = palpate.refusal("evaluate", "--train", archive, "--split", "session")
    assert "--train must have a column 'session'" in result
    assert "--levels object/session" in result


def test_touches_read_alike_that_differ_are_told_what_to_do(palpate, archive, tmp_path):
    days = put_each(tmp_path / "set", 1, ["mug/mon", "mug/tue", "pen/mon", "pen/tue"])
    words = "evaluate", "--train", days, "--levels", "object/session", "--unknown"
    strangers = put_each(tmp_path / "other", 1, ["saw"])
    for others in (archive, strangers):
        result = palpate.refusal(*words, others, "--split", "session")
        assert "--unknown alike; if they differ, bring each into a library" in result
    assert "Give --levels or a --name-pattern as these paths are" in result


def test_evaluate_of_what_was_taught_says_so_in_words_of_the_command(palpate, archive):
    words = ["evaluate", "--train", archive, "--test", archive, "--touches", "1"]
    verdict = palpate.answer(*words)["verdict"]
    assert verdict.startswith("This says little of new touches: ")
    assert verdict.endswith("or evaluate one set with --split last.")


def test_evaluate_prints_json_and_writes_the_report(palpate, archive, tmp_path):
    pytest.importorskip("matplotlib", reason='needs the extra "plot"')
    report = tmp_path / "r.html"
    words = ["evaluate", "--train", archive, "--split", "last", "--touches", "1,3"]
    result = palpate(*words, "--report", report, "--json")
    figures = json.loads(result.stdout)
    assert set(figures["accuracy"]) == {"1", "3"}
    assert report.read_text().startswith("<!doctype html>")
    assert result.stderr == ""


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_has_help_and_stands_in_the_docs(palpate, words):
    command = dict(commands())[words]
    assert command.help
    assert all(parameter.help for parameter in command.params)
    assert any("--json" in parameter.opts for parameter in command.params)
    result = palpate(*words, "--help")
    assert result.returncode == 0
    assert palpate(*words, "-h").stdout == result.stdout
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    wanted = re.compile(rf"palpate {' '.join(words)}\b")
    assert any(wanted.search(page.read_text(encoding="utf-8")) for page in pages)


def test_the_first_help_lists_every_verb(palpate):
    listed = palpate("-h").stdout
    assert palpate("--help").stdout == listed
    for verb, *_ in COMMANDS:
        assert f" {verb} " in listed


def run(code, **variables):
    """Run Python code in a process of its own."""
    environment = {**os.environ, **variables}
    command = [sys.executable, "-c", code]
    return subprocess.run(command, env=environment, capture_output=True, text=True)


def test_help_loads_nothing_heavy():
    result = run(
        "import functools, sys, typer.main\n"
        "from palpate.cli import main\n"
        "typer.main.get_command = functools.cache(typer.main.get_command)\n"
        f"for words in {[*map(list, COMMANDS), []]}:\n"
        "    for wish in ['--help'] + ['--version'] * (not words):\n"
        "        sys.argv = ['palpate', *words, wish]\n"
        "        try: main()\n"
        "        except SystemExit as end: assert not end.code\n"
        "heavy = {'numpy', 'sklearn', 'cv2', 'matplotlib', 'scipy', 'joblib'}\n"
        "assert not heavy & {*sys.modules}, heavy & {*sys.modules}"
    )
    assert result.returncode == 0, result.stderr


def test_the_version_stands_in_one_place(palpate):
    assert palpate("--version").stdout == f"palpate {package.__version__}\n"
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert "version" not in project["project"]
    dynamic = project["tool"]["setuptools"]["dynamic"]
    assert [*dynamic["version"]] == ["attr"]  # read from the code itself


def test_a_shell_completes_verbs():
    result = run(
        "import sys; sys.argv = ['palpate']; import palpate.cli as c; c.main()",
        COMP_WORDS="palpate rec",
        COMP_CWORD="1",
        _PALPATE_COMPLETE="complete_bash",
    )
    assert result.stdout.split() == ["recognise", "record"], result.stderr


def test_help_works_beside_json(palpate):
    assert palpate.printed("learn", "--json", "-h")


def test_touches_without_an_order_are_split_as_read_and_a_note_says_so(
    palpate, archive, tmp_path
):
    def words(touches):
        touches.save(tmp_path / "t.npz")
        return ["evaluate", "--train", tmp_path / "t.npz", "--split", "last"]

    note = "The touches have no column order or time_s, which tells when each was made"
    touches = Touches.load(archive).without("order")
    assert note in " ".join(palpate.printed(*words(touches)).split())
    assert note in palpate.answer(*words(touches))["notes"][-1]
    for name in ("order", "time_s"):  # `record` writes the second
        ordered = touches.with_columns(**{name: np.arange(len(touches))})
        assert note not in palpate.printed(*words(ordered))


def test_one_picture_is_recognised(palpate, tmp_path):
    put_each(tmp_path / "t", 8)
    palpate.printed("learn", tmp_path / "t", "-o", tmp_path / "m.palpate")
    picture = tmp_path / "t" / "pen" / "3.png"
    result = palpate.answer("recognise", tmp_path / "m.palpate", picture)
    (episode,) = result["episodes"]
    assert episode["object"] is None
    (belief,) = episode["beliefs"]
    assert max(belief["posterior"], key=belief["posterior"].get) == "pen"


def test_doctor_checks_every_dependency_of_the_package(palpate):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lists = [project["dependencies"]]
    for extra, lines in project["optional-dependencies"].items():
        lists += [lines] * (extra not in ("test", "dev", "docs"))
    wanted = {re.split(r"[>=<\[]", line)[0] for lines in lists for line in lines}
    wanted -= {"palpate"}  # an extra that brings another
    answer = palpate.answer("doctor")
    assert answer["healthy"]
    names = {check["name"] for check in answer["checks"]}
    assert names == wanted | {"Python", "PALPATE_DATA"}


@pytest.mark.parametrize(
    ("name", "command", "code"),
    [
        ("matplotlib", 'pip install "palpate[plot]"', 0),
        ("faiss-cpu", 'pip install "palpate[index]"', 0),
        ("rich", "pip install rich", 1),
    ],
)
def test_doctor_says_what_to_type(palpate, monkeypatch, name, command, code):
    original = metadata.version

    def version(distribution):
        if distribution == name:
            raise metadata.PackageNotFoundError(name)
        return original(distribution)

    monkeypatch.setattr(metadata, "version", version)
    # The command to type stays in one line, however long the other cells are.
    monkeypatch.setenv("PALPATE_DATA", "/a/folder/with/a/rather/long/name/indeed")
    result = palpate("doctor")
    assert result.returncode == code
    (line,) = (line for line in result.stdout.splitlines() if f" {name} " in line)
    cells = [cell.strip() for cell in line.strip("│┃").split("│")]
    assert cells == [name, "missing", command]


@pytest.mark.parametrize("width", [60, 80])
def test_doctor_keeps_names_whole_in_a_narrow_terminal(palpate, monkeypatch, width):
    monkeypatch.setenv("COLUMNS", str(width))
    lines = palpate("doctor").stdout.splitlines()
    assert max(map(len, lines)) <= width
    names = {line.strip("│┃").split("│")[0].strip() for line in lines}
    assert {"opencv-python-headless", "cv2-enumerate-cameras"} <= names
    assert lines[-1] == "Try it: palpate demo"


def test_figures_in_a_pipe_are_not_broken(palpate, tmp_path, monkeypatch):
    """Each line of a table is as long as it is, however wide its values are."""
    monkeypatch.delenv("COLUMNS", raising=False)
    names = [f"{letter * 60} {number}" for number, letter in enumerate("abc")]
    with TouchLibrary.open(tmp_path / "lab", create=True) as library:
        library.add(Touches(np.ones((3, 2, 2)), object=names, category=names))
    listed = palpate.printed("library", "list", tmp_path / "lab", "--objects")
    assert all(name in listed for name in names)


@pytest.mark.parametrize("width", [60, 80])
def test_help_breaks_its_lines_where_the_terminal_does(palpate, monkeypatch, width):
    """Each paragraph fills its lines: the first word of the next would not fit."""
    monkeypatch.setenv("COLUMNS", str(width))
    for verb in ("check", "learn", "recognise", "evaluate", "demo", "remount"):
        help_text = palpate(verb, "--help").stdout
        above = help_text[help_text.index("Usage") :].partition("╭")[0]
        for paragraph in re.split(r"\n\s*\n", above):
            lines = paragraph.rstrip().splitlines()
            for line, after in pairwise(lines):
                assert len(line.rstrip()) + 1 + len(after.split()[0]) > width - 2


def test_an_option_without_a_value_shows_no_type_of_one(palpate, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    help_text = palpate("learn", "--help").stdout
    for name in ("--json", "--skip-bad", "--colour"):
        (line,) = (line for line in help_text.splitlines() if f" {name} " in line)
        assert "<" not in line


def test_square_brackets_are_no_markup(palpate, monkeypatch, tmp_path):
    monkeypatch.setenv("COLUMNS", "200")
    words = " ".join(palpate("learn", "--help").stdout.replace("│", " ").split())
    assert 'needs pip install "palpate[distributed]"' in words
    help_text = palpate("simulate", "array", "--help").stdout
    words = " ".join(help_text.replace("│", " ").split())
    assert "Side of a taxel, mm [0.65 pitch]." in words
    names = ["[bold]mug[/bold]", ":cat: [/]"]
    with TouchLibrary.open(tmp_path / "[red]lab", create=True) as library:
        library.add(Touches(np.zeros((2, 3, 3)), object=names))
    printed = palpate("library", "list", tmp_path / "[red]lab", "--objects").stdout
    assert all(name in printed for name in names)
    assert "[red]lab" in printed.replace("\n", "")
    assert "[plot]" in palpate.refusal("bench", "[plot]")
    live = ("live", "m.palpate", "--sensor", "[plot]")
    assert "[plot]" in palpate.refusal(*live, code=2)


def test_bench_lists_its_names(palpate):
    assert "zernike" in palpate("bench", "--list").stdout
    assert "zernike" in palpate.answer("bench", "--list")["benches"]


def test_an_installed_palpate_says_where_benchmarks_are(tmp_path, monkeypatch):
    verb = import_module("palpate.cli.bench")
    installed = tmp_path / "lib" / "palpate" / "cli" / "bench.py"
    monkeypatch.setattr(verb, "__file__", str(installed))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match="Clone its repository, and call it there"):
        verb.bench("likelihood")


@pytest.mark.parametrize(
    ("written", "message"),
    [
        ("level = 'object'", "got level = 'object'. Choose among where, name-pattern,"),
        ("channels = ['x']", r"must hold options .* got channels = \['x'\]"),
        ("levels = 3", "--levels must name each level .* got '3'"),
        ("skip-bad = 2", "--skip-bad must be true or false, got '2'"),
        ("begin = true", "--begin must be a number such as 1, got 'True'"),
        ("levels =", "--read must be a TOML file, got .*reading.toml: Invalid value"),
    ],
)
def test_a_file_of_reading_options_is_checked(palpate, tmp_path, written, message):
    profile = tmp_path / "reading.toml"
    profile.write_text(written)
    result = palpate("check", tmp_path, "--read", profile)
    assert result.returncode in (1, 2)
    assert re.search(message, " ".join(result.stderr.split()))


def test_paths_in_a_file_of_reading_options_start_there(palpate, tmp_path):
    (tmp_path / "there").mkdir()
    profile = tmp_path / "there" / "reading.toml"
    profile.write_text("no-contact = 'rest.png'")
    touch = put(tmp_path / "touch.png")
    result = palpate.refusal("check", touch, "--read", profile)
    assert str(tmp_path / "there" / "rest.png") in result


def test_an_option_that_is_typed_wins_over_a_file_even_at_its_default(
    palpate, tmp_path
):
    profile = tmp_path / "reading.toml"
    profile.write_text("max-megapixels = 0.0001")
    put(tmp_path / "set" / "mug" / "1.png")
    words = ["check", tmp_path / "set", "--read", profile]
    problem = palpate.answer(*words, code=1)["problem"]
    assert "100 pixels" in problem
    assert "or raise --max-megapixels if you trust it" in problem
    assert palpate.answer(*words, "--max-megapixels", "50")["n_touches"] == 1


@pytest.mark.slow
def test_levels_of_folders_are_named(palpate, tmp_path):
    folder = put_each(tmp_path / "set", 4, ["mug/mon", "mug/tue", "pen/mon", "pen/tue"])
    words = ["learn", folder, "-o", tmp_path / "m.palpate"]
    learnt = palpate.answer(*words, "--levels", "object/session")
    assert learnt["labels"] == ["mug", "pen"]
    assert learnt["sessions"]["least"] == 2
    assert "read as category/object; --levels says otherwise" in palpate.printed(*words)
    kinds = palpate.answer(*words)["labels"]
    assert palpate.answer(*words, "--levels", "category/object")["labels"] == kinds
    profile = tmp_path / "reading.toml"
    profile.write_text('levels = "object/session"\nskip-bad = true\n')
    words += ["--read", profile]
    assert palpate.answer(*words)["labels"] == ["mug", "pen"]
    assert palpate.answer(*words, "--levels", "category/object")["labels"] == kinds


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--preset", "defalt"], "--preset must be one of"),
        (["--label", "things"], "--label must be one of"),
        (["--presentation", "turn"], "Did you mean 'turned'?"),
        (["--levels", "mug"], "--levels must name each level"),
        (["--levels", "session"], "one of them object"),
        (["--levels", "object/a b"], "by a word"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_a_wrong_choice_is_refused_before_anything_is_read(
    palpate, monkeypatch, tmp_path, words, message
):
    monkeypatch.setattr(Touches, "load", lambda *_, **__: pytest.fail("read"))
    learn = "learn", tmp_path, "-o", "m.palpate"
    for verb in (learn, ("evaluate", "--train", tmp_path)):
        refused = palpate.refusal(*verb, *words, code=2)
        assert message in refused
        assert len(refused.splitlines()) == 1
    wrong = palpate.answer("evaluate", "--train", tmp_path, "--split", "lst", code=2)
    assert "Did you mean 'last'?" in wrong["error"]


def test_learning_says_first_what_was_learnt_then_which_touches_are_missing(
    palpate, tmp_path
):
    rng = np.random.default_rng(0)
    levels = rng.normal(np.repeat((60, 150), (20, 3))[:, None, None], 9, (23, 8, 8))
    levels[:3] = 0
    whole = {"object": ["mug"] * 20 + ["pen"] * 3, "no_contact": levels[0]}
    Touches(levels, **whole).save(tmp_path / "t.npz")
    model = tmp_path / "m.palpate"
    printed = palpate.printed("learn", tmp_path / "t.npz", "-o", model)
    first, few, idle, *_ = printed.splitlines()
    assert first == f"Learnt 2 objects from 23 touches, saved as {model}."
    assert few == "Few touches of pen (3): 20 are a start, 60 are good."
    assert idle.startswith("3 of 23 touches show no contact, which tells nothing")
    levels[20:22] = 0
    Touches(levels, **whole).save(tmp_path / "t.npz")
    printed = palpate.printed("learn", tmp_path / "t.npz", "-o", model)
    idle = printed.splitlines()[2]
    assert idle.startswith("Most touches of pen show no contact, so that touching")


def test_ctrl_c_while_the_command_is_imported_is_one_sentence():
    result = run(
        "import builtins, palpate.__main__ as command\n"
        "real = builtins.__import__\n"
        "def stopped(name, *rest):\n"
        "    if name == 'typer': raise KeyboardInterrupt\n"
        "    return real(name, *rest)\n"
        "builtins.__import__ = stopped\n"
        "command.main()"
    )
    assert result.returncode == 130
    assert result.stderr == "palpate: Stopped by Ctrl-C before anything was begun.\n"
