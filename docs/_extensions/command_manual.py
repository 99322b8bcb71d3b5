"""Manual pages made from the commands: the directive `{command}` with a command's name."""

from __future__ import annotations

import typer.main
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from typer.cli import get_docs_for_click

from bayes_inertia.app.cli import command_line
from bayes_inertia.app.options import EXAMPLES


def manual_text(name: str) -> str:
    """What a command does, its arguments and options with defaults, and examples, in Markdown."""
    group = typer.main.get_command(command_line())
    described = get_docs_for_click(
        obj=group.commands[name], ctx=typer.Context(group), name=name, call_prefix="bayes-inertia"
    )
    # The first line is the heading, which the page has; the end of the help is said below.
    text = described.split("\n", 1)[1].split("\nExample:\n", 1)[0]
    text = text.replace("\b", "").replace("{", "").replace("}", "")
    examples = "\n".join(f"bayes-inertia {words}" for words in EXAMPLES[name])
    return f"{text}\n**Examples**:\n\n```sh\n{examples}\n```\n"


class CommandManual(SphinxDirective):
    """`{command} fit`: the manual of `bayes-inertia fit`."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """The parsed manual text."""
        return self.parse_text_to_nodes(manual_text(self.arguments[0]))


def setup(app: Sphinx) -> dict[str, bool]:
    """Offer the directive."""
    app.add_directive("command", CommandManual)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
