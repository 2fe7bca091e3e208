"""The commands in groups, their help, and the commands that earlier versions had."""

from __future__ import annotations

from typing import Any

from typer.core import TyperCommand, TyperGroup

from dynaviz.errors import UsageError

try:
    from typer import TyperException as CommandLineError
except ImportError:  # earlier versions of typer raise the exceptions of click
    from click import ClickException as CommandLineError  # type: ignore[assignment]

__all__ = ["GROUPS", "RENAMED", "Command", "CommandLineError", "Commands"]

GROUPS: dict[str, tuple[str, ...]] = {
    "Clean": ("demo", "clean", "live"),
    "Look": ("explore", "view", "why", "compare"),
    "Evaluate": ("run", "score", "bench", "tune", "report", "check"),
    "Data": ("info", "doctor", "list", "simulate", "convert"),
}
"""The commands by heading, in the order of the help."""

FIRST = 5  # options of a command above its other ones
RENAMED = {
    "board": "report FOLDER --format board",
    "config": "list METHOD",
    "failures": "info RUN --failures",
    "implant": "simulate implant:SEQ FOLDER",
    "repair": "info RECORDING",
    "rescore": "score RUN",
    "shot": "view RUN -o PICTURE.png",
    "download": "convert download:NAME FOLDER",
    "export-labels": "convert RUN FOLDER --labels",
}
"""Commands of earlier versions, and what to type instead."""


class Command(TyperCommand):
    """A command whose help lists the options that most people need before the others."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """List the arguments, the first ``FIRST`` options and the other options."""
        listed: dict[str, list[Any]] = {"argument": [], "option": []}
        for each in self.get_params(ctx):
            if (row := each.get_help_record(ctx)) is not None:
                listed[each.param_type_name].append(row)
        options = listed["option"]
        first = len(options) if len(options) <= FIRST + 2 else FIRST
        parts = {
            "Arguments": listed["argument"],
            "Options": options[:first],
            "More options": options[first:],
        }
        for heading, rows in parts.items():
            if rows:
                with formatter.section(heading):
                    formatter.write_dl(rows)


class Commands(TyperGroup):
    """All commands. Wrong usage gives one line, like every other error that a user can cause."""

    def invoke(self, ctx: Any) -> Any:
        """Run the chosen command."""
        try:
            return super().invoke(ctx)
        except CommandLineError as error:
            problem = error.format_message().replace("Value error, ", "")
            context = getattr(error, "ctx", None) or ctx  # only errors of usage have a context
            end = "" if problem.endswith((".", "?")) else "."
            text = (
                f"{problem[0].lower()}{problem[1:]}{end} For examples run: {context.command_path} "
                "--help"
            )
            raise UsageError(text) from error

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command; the name of an earlier one gives an error with its successor."""
        if args and (now := RENAMED.get(args[0])):
            raise UsageError(f"'{ctx.command_path} {args[0]}' is now '{ctx.command_path} {now}'")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """List the commands under the headings of ``GROUPS``."""
        widest = max(map(len, self.commands))
        for heading, names in GROUPS.items():
            with formatter.section(heading):
                formatter.write_dl(
                    [
                        (
                            name.ljust(widest),
                            self.commands[name].get_short_help_str(formatter.width - 6 - widest),
                        )
                        for name in names
                    ]
                )
