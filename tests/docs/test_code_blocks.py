"""Every block of code on the pages: commands parse, Python runs, TOML is read.

A block that takes long or needs what is not here says so in a comment above it,
`<!-- not run: why. tests/... -->`; its names and arguments are checked all the same. Cells of the
tutorials are run by `make docs`.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import shlex
import tomllib
from dataclasses import dataclass
from pathlib import Path

import pytest
import typer.main
from markdown_it import MarkdownIt
from support.marks import LIKE_ANOTHER

import bayes_inertia as bi
from bayes_inertia.app.cli import COMMANDS, command_line
from bayes_inertia.errors import CampaignError

ROOT = Path(bi.__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
# What Sphinx itself reads, and output of commands.
NOT_CODE = ("{", "text")
# Pages whose blocks fit a campaign.
SLOW = ("docs/how_to/own_sampler.md",)
# Pages without such comments.
NOT_RUN = {"README.md": "fit and diagnosis take two minutes. tests/test_diagnosed_fit.py"}
# Programs beside ours that a page may call.
OTHER_PROGRAMS = (
    "make",
    "python",
    "python3",
    "pip",
    "uv",
    "conda",
    "docker",
    "apptainer",
    "dask",
    "kubectl",
)
GROUP = typer.main.get_command(command_line())


@dataclass(frozen=True)
class Block:
    """A block of code on a page, and why it is not run; empty if it is."""

    page: Path
    line: int
    language: str
    text: str
    not_run: str

    @property
    def place(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


def blocks_of(page: Path) -> list[Block]:
    found, comment, of_page = [], "", NOT_RUN.get(page.name, "")
    for token in MarkdownIt().parse(page.read_text(encoding="utf-8")):
        if token.type == "fence" and not token.info.startswith(NOT_CODE):
            not_run = re.search(r"<!-- not run: (.+?) -->", comment, re.DOTALL)
            line = (token.map or [0])[0] + 1
            found.append(
                Block(page, line, token.info, token.content, not_run[1] if not_run else of_page)
            )
        comment = token.content if token.type == "html_block" else ""
    return found


BLOCKS = [block for page in PAGES for block in blocks_of(page)]


def of_language(language: str):
    blocks = [block for block in BLOCKS if block.language == language]
    assert blocks, language
    marked = [
        pytest.param(
            block,
            id=block.place,
            marks=LIKE_ANOTHER if block.place.startswith(SLOW) else (),
        )
        for block in blocks
    ]
    return pytest.mark.parametrize("block", marked)


def test_every_block_says_its_language():
    known = {"sh", "python", "toml"}
    assert [b.place for b in BLOCKS if b.language not in known] == []


def commands_in(text: str) -> list[list[str]]:
    """The words of each command of a block, without comments and what they are piped to."""
    lines = text.replace("\\\n", " ").splitlines()
    split = [shlex.split(line.split("<(")[0], comments=True) for line in lines]
    return [words[:-1] if words[-1] == "&" else words for words in split if words]


def fault_of(words: list[str]) -> str:
    """What is wrong with a command; empty if nothing is."""
    program = Path(words[0]).name
    if program == "make":
        targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
        return "" if set(words[1:]) <= set(targets) else f"no such target: {words[1:]}"
    module = words[2] if words[1:2] == ["-m"] else ""
    if module.startswith("analyses") and not (ROOT / f"{module.replace('.', '/')}.py").is_file():
        return f"no such module: {module}"
    if program != "bayes-inertia":
        files = [word for word in words[1:] if word.endswith((".py", ".yaml"))]
        missing = [file for file in files if not (ROOT / file).is_file()]
        unknown = "" if program in OTHER_PROGRAMS else f"unknown program {program}"
        return f"no such file: {missing}" if missing else unknown
    rest = [word for word in words[1:] if word not in ("--quiet", "-q", "--no-cache")]
    if rest[0] not in COMMANDS:
        return "" if rest[0] in ("--help", "--version") else f"no command {rest[0]}"
    try:
        GROUP.commands[rest[0]].make_context(rest[0], rest[1:])
    except typer.TyperException as error:
        return f"{' '.join(words)}: {error.format_message()}"
    except typer.Exit:
        return ""
    return ""


@of_language("sh")
def test_commands_parse(block):
    faults = [fault_of(words) for words in commands_in(block.text)]
    assert [fault for fault in faults if fault] == []


@pytest.mark.parametrize(
    "command",
    [
        "bayes-inertia fti CAMPAIGN -o RUN",
        "bayes-inertia fit CAMPAIGN",
        "bayes-inertia fit CAMPAIGN -o RUN --drive commands",
        "bayes-inertia fit CAMPAIGN -o RUN --effect rate_bias",
        "make tests",
        "python -m analyses.no_such_module",
        "rm -rf /",
    ],
)
def test_the_check_of_commands_can_fail(command):
    assert fault_of(shlex.split(command))


@of_language("toml")
def test_toml_is_read(block, tmp_path):
    content = tomllib.loads(block.text)
    if content.get("format", "").startswith("bayes-inertia-campaign/"):
        (tmp_path / "campaign.toml").write_text(block.text, encoding="utf-8")
        # All that is wrong is that its tables are not here.
        with pytest.raises(CampaignError, match=r"slew_01\w*\.csv"):
            bi.read_campaign(tmp_path)


def resolved(node: ast.expr, names: dict[str, object]) -> object:
    """What a dotted name of imported things means; None if it is something else."""
    if isinstance(node, ast.Name):
        return names.get(node.id)
    if isinstance(node, ast.Attribute):
        owner = resolved(node.value, names)
        if inspect.ismodule(owner) or inspect.isclass(owner):
            return getattr(owner, node.attr)
    return None


def check_names(text: str) -> None:
    """AttributeError, ImportError or TypeError for what the package does not have or accept."""
    names: dict[str, object] = {}
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                names[alias.asname or alias.name] = importlib.import_module(alias.name)
        elif isinstance(node, ast.ImportFrom):
            module = importlib.import_module(node.module or "")
            for alias in node.names:
                names[alias.asname or alias.name] = getattr(module, alias.name)
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            resolved(node, names)
        if isinstance(node, ast.Call) and callable(called := resolved(node.func, names)):
            keywords = {keyword.arg: None for keyword in node.keywords if keyword.arg}
            inspect.signature(called).bind_partial(*node.args, **keywords)


@of_language("python")
def test_python_runs(block, monkeypatch, tmp_path):
    check_names(block.text)
    if block.not_run:
        for path in re.findall(r"(?:tests|docs)/\S+\.(?:py|md)", block.not_run):
            assert (ROOT / path).is_file(), path
        return
    # What the pages read lies in the checkout; what they write must not.
    for folder in ("bayes_inertia", "docs", "tests"):
        (tmp_path / folder).symlink_to(ROOT / folder, target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    exec(compile(block.text, block.place, "exec"), {"__name__": "__main__"})


@pytest.mark.parametrize(
    "text",
    [
        "import bayes_inertia as bi\nbi.fits(1)",
        "import bayes_inertia as bi\nbi.fit(campaign, sede=1)",
        "from bayes_inertia.physics.effects import NoSuchEffect",
        "import bayes_inertia as bi\nbi.Posterior.read('a')",
    ],
)
def test_the_check_of_names_can_fail(text):
    with pytest.raises((AttributeError, ImportError, TypeError)):
        check_names(text)
