"""``fiohost completion``: what a shell needs to complete commands, options and names."""

from __future__ import annotations

import os
from pathlib import Path

import click
from click.shell_completion import get_completion_class

from fiohost.errors import ConfigError
from fiohost.settings import nearest

SHELLS = ("bash", "zsh", "fish")
VARIABLE = "_FIOHOST_COMPLETE"
# where a line is put, or, for fish, the script itself
FILES = {"bash": ".bashrc", "zsh": ".zshrc", "fish": ".config/fish/completions/fiohost.fish"}


@click.command()
@click.argument("shell", required=False)
@click.option("--install", is_flag=True, help="Put it where the shell reads it at its start.")
def completion(shell: str | None, install: bool) -> None:
    """Complete commands, options, experiments, targets, models, effects and maps with the tab key of SHELL: bash, zsh
    or fish. Prints the script, or puts it in place; it holds from the next shell on.

    \b
    Examples:
      fiohost completion bash --install
      eval "$(fiohost completion zsh)"
    """
    name = shell or Path(os.environ.get("SHELL", "")).name
    if name not in SHELLS:
        said = "say which SHELL" if not name else f"unknown shell {name!r}"
        raise ConfigError(f"{said}; {nearest(name, SHELLS)}")
    made = get_completion_class(name)
    if made is None:
        raise ConfigError(f"this version of click completes nothing for {name}")
    context = click.get_current_context().find_root()
    script = made(context.command, {}, "fiohost", VARIABLE).source()
    if name == "bash":  # else it would take sim:default for three words
        script = f"COMP_WORDBREAKS=${{COMP_WORDBREAKS//:}}\n{script}"
    if not install:
        click.echo(script)
        return
    path = Path.home() / FILES[name]
    line = f'eval "$(fiohost completion {name})"'
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if name == "fish":
            path.write_text(script, encoding="utf-8")
        elif not path.exists() or line not in path.read_text(encoding="utf-8", errors="replace"):
            with path.open("a", encoding="utf-8") as file:
                file.write(f"\n# completion of fiohost\n{line}\n")
    except OSError as exc:
        raise ConfigError(f"cannot write {path}: {exc.strerror}") from exc
    click.echo(f"{path}: fiohost completes from the next {name} on")
