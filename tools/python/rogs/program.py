"""The program `rogs`, for what needs the networks: runs, and times that a field does not store."""

from __future__ import annotations

import json
import os
import shutil
import subprocess

from ._rogs import RogsError


def find_program() -> str:
    """Path of the program: that of `ROGS_PROGRAM`, else `rogs` on the PATH.

    Raises RogsError where there is none.
    """
    path = os.environ.get("ROGS_PROGRAM") or shutil.which("rogs")
    if not path:
        raise RogsError("the program `rogs` is needed: put it on the PATH, or name it in ROGS_PROGRAM")
    return path


def run_program(*arguments: str | os.PathLike, cwd: str | os.PathLike | None = None) -> str:
    """Calls the program and gives what it prints.

    Raises RogsError with its message where it fails.
    """
    words = [find_program(), *map(os.fspath, arguments)]
    done = subprocess.run(words, cwd=cwd, capture_output=True, text=True)
    if done.returncode:
        said = done.stderr.strip().splitlines()
        raise RogsError(f"`rogs {' '.join(words[1:])}` ended with {done.returncode}: " + "\n".join(said[-20:]))
    return done.stdout


def run(manifest: str | os.PathLike, *arguments: str) -> dict | list | str:
    """Runs a manifest (`rogs run MANIFEST --json`): what is up to date stays, so it may be called again and again.

    `arguments` are further ones of the command. Gives the JSON that it prints.
    """
    text = run_program("run", manifest, "--json", *arguments)
    lines = [line for line in text.splitlines() if line.strip()]
    try:
        return json.loads(text)
    except ValueError:
        return [json.loads(line) for line in lines]
