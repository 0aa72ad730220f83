"""The site has a page for every public name and short examples."""

import ast
import inspect
import re
import runpy
import shutil
import subprocess
import sys
import textwrap
from importlib import import_module
from pathlib import Path

import pytest

from structure import public_names

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
CHROMIUM = Path("/usr/bin/chromium")
EXAMPLES = sorted((ROOT / "examples").glob("plot_*.py"))
# The command line has a page of its own.
SUBPACKAGES = {
    k: v for k, v in public_names(ROOT / "src" / "palpate").items() if k != "cli"
}
SAYS_ERRORS = re.compile(r"Raise|refus|Error")
# Objects that a caller gets but never makes: the docstring names what makes them.
MADE_BY = re.compile(r"Made by `\w+")


@pytest.fixture(scope="module")
def pages():
    return runpy.run_path(str(DOCS / "reference.py"))


def test_every_public_name_gets_a_page(pages):
    for subpackage, names in SUBPACKAGES.items():
        page = pages["subpackage_page"](subpackage)
        assert [n for n in names if f"palpate.{subpackage}.{n}\n" not in page] == []


@pytest.mark.parametrize("subpackage", SUBPACKAGES)
def test_docstrings_name_every_parameter_and_the_errors(subpackage):
    """A section of parameters or attributes names them, or a text between backticks."""
    module = import_module(f"palpate.{subpackage}")
    silent = []
    for name in module.__all__:
        thing = getattr(module, name)
        docstring = inspect.getdoc(thing) or ""
        if not (inspect.isclass(thing) or inspect.isfunction(thing)):
            continue
        if not (MADE_BY.search(docstring) or getattr(thing, "_is_protocol", False)):
            silent += [
                f"{name}: {parameter}" for parameter in _unnamed(thing, docstring)
            ]
        if (
            inspect.isfunction(thing)
            and _raises(thing)
            and not SAYS_ERRORS.search(docstring)
        ):
            silent.append(f"{name}: errors")
    assert silent == []


def _unnamed(thing, docstring):
    """Return the parameters that a docstring does not name."""
    try:
        parameters = list(inspect.signature(thing).parameters)
    except ValueError:  # a built-in error
        return []
    return [
        name
        for name in parameters
        if name not in ("X", "y")
        and not re.search(
            rf"^\**{name}\b[\w*, ]*(:|$)|^[\w*, ]+, {name}\b", docstring, re.M
        )
        and not re.search(rf"[`*]{name}\b", docstring)
    ]


def _raises(function):
    """Return whether a function itself raises an error or calls a check."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    return any(
        isinstance(node, ast.Raise)
        or (isinstance(node, ast.Call) and getattr(node.func, "id", "")[:6] == "check_")
        for node in ast.walk(tree)
    )


def test_the_pages_of_commands_and_addresses_have_them(pages):
    pytest.importorskip("fastapi", reason='pip install "palpate[web]"')
    commands = pages["command_page"]()
    for words in ("learn", "library add", "explore recognise", "sensor check"):
        assert f"## palpate {words}\n" in commands
    assert "`--pitch-mm float`" in commands
    addresses = pages["http_page"]()
    assert "## GET /api/state\n" in addresses
    assert "\n| `" in addresses  # some addresses take parameters


def test_the_gallery_is_large_enough_and_each_program_short():
    assert len(EXAMPLES) >= 20
    for path in EXAMPLES:
        text = path.read_text("utf-8")
        assert len(text.splitlines()) <= 70, path.name
        title, line = text.splitlines()[1:3]
        assert len(title) == len(line), path.name
        assert ("os.environ" in text) == ("needs recorded touches" in text), path.name


@pytest.mark.parametrize("folder", ["benchmarks", "examples", "plugs"])
def test_what_programs_outside_the_package_import_is_there(folder):
    pytest.importorskip("gymnasium", reason="of environments is imported what needs it")
    nodes = (
        node
        for path in (ROOT / folder).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.ImportFrom) and not node.level
    )
    for node in nodes:
        if node.module.partition(".")[0] == "palpate":
            exec(ast.unparse(node), {})


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Build the site without the programs of the gallery, which have other tests."""
    for module in ("numpydoc", "myst_parser", "sphinx_gallery", "pydata_sphinx_theme"):
        pytest.importorskip(module, reason='pip install "palpate[docs]"')
    folder = tmp_path_factory.mktemp("site")
    ignored = shutil.ignore_patterns("_build", "gallery", "generated")
    shutil.copytree(DOCS, folder / "docs", ignore=ignored)
    shutil.copytree(ROOT / "examples", folder / "examples")
    built = folder / "html"
    completed = subprocess.run(
        [
            *f"{sys.executable} -m sphinx -q -W --keep-going".split(),
            "-D",
            "plot_gallery=0",
            str(folder / "docs"),
            str(built),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert completed.returncode == 0, completed.stderr
    return built


@pytest.mark.slow
def test_the_site_is_built_and_loads_nothing_from_outside(site):
    names = site / "reference" / "generated" / "names"
    for subpackage, public in SUBPACKAGES.items():
        for name in public:
            assert (names / f"palpate.{subpackage}.{name}.html").is_file()
    page = (names / "palpate.recognition.ObjectRecogniser.html").read_text("utf-8")
    assert 'rubric">Methods' in page  # a table of methods comes first
    titles = re.compile(r"<h1>(.*?)<a")
    pages = [path.read_text("utf-8") for path in site.rglob("*.html")]
    found_titles = [titles.search(page) for page in pages]
    page_titles = [title[1] for title in found_titles if title]
    assert page_titles.count("The command line") == 1
    loads = re.compile(
        r'<(?:script|img|link rel="stylesheet)[^>]+(?:src|href)="(http[^"]+)'
    )
    addresses = {address for page in pages for address in loads.findall(page)}
    assert addresses == set()


@pytest.mark.slow
def test_the_site_fits_a_phone_and_finds_the_recogniser(site):
    """No page scrolls sideways; the first screen and the search show the essentials."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed"
    )
    if not CHROMIUM.exists():
        pytest.skip("Debian's chromium is not installed (apt install chromium)")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=str(CHROMIUM),
            args=["--no-sandbox", "--allow-file-access-from-files"],
        )
        phone = browser.new_page(viewport={"width": 390, "height": 844})
        wide = []
        for path in sorted(site.rglob("*.html")):
            phone.goto(path.as_uri(), wait_until="domcontentloaded")
            if phone.evaluate("document.documentElement.scrollWidth") > 390:
                wide.append(path.name)
        assert wide == []
        desk = browser.new_page(viewport={"width": 1280, "height": 900})
        desk.goto((site / "index.html").as_uri())
        for part in ("text=pip install", "img[src$='belief.gif']"):
            box = desk.locator(part).first.bounding_box()
            assert box["y"] + box["height"] < 900
        header = desk.locator("header")
        assert header.locator("img.logo__image").first.is_visible()
        assert header.locator("a[href*='github.com/palpate']").first.is_visible()
        desk.goto((site / "search.html").as_uri() + "?q=fit")
        first = desk.locator("#search-results li").first
        playwright.expect(first).to_contain_text("ObjectRecogniser.fit")
        browser.close()
