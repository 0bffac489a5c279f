"""Finding and reading the files that people write: YAML and JSON, no key twice, into frozen dataclasses."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from core.errors import InputError
from core.structured import one_of, parse

CONFIGS = Path(__file__).resolve().parents[1] / "configs"
T = TypeVar("T")


def config_file(folder: str, name_or_file: str | Path) -> Path:
    """`configs/<folder>/<name>.yaml`, or the file itself. Raises InputError naming the files that exist."""
    path = Path(name_or_file)
    if path.suffix in (".yaml", ".yml"):
        if not path.is_file():
            raise InputError("no such file", where=path)
        return path
    names = sorted(file.stem for file in (CONFIGS / folder).glob("*.yaml"))
    one_of(None, str(name_or_file), [*names, "or a .yaml file"], what=f"unknown {folder} configuration")
    return CONFIGS / folder / f"{name_or_file}.yaml"


def load_options(kind: type[T], path: Path) -> T:
    """Read a YAML mapping into the dataclass ``kind``. Raises InputError naming file and full path of the entry."""
    content = read_yaml(path)
    with errors_in(path):
        return parse(kind, content)


@contextmanager
def errors_in(path: str | Path | None) -> Iterator[None]:
    """Errors about the content of a file, or of something that has a name, name it; as they are where it has none."""
    try:
        yield
    except InputError as error:
        raise InputError(str(error), where=path) from error


def read_yaml(path: Path) -> dict[str, Any]:
    """The mapping in a YAML file; nothing in it is executed.

    Raises InputError naming the file: not there, not YAML, a key given twice, no mapping.
    """
    from core.yaml_text import YAMLError, parse_yaml  # which `--help` need not wait for

    try:
        with path.open("rb") as file:
            content = parse_yaml(file)
    except FileNotFoundError as error:
        raise InputError("no such file", where=path) from error
    except (OSError, ValueError, YAMLError, RecursionError) as error:
        raise InputError("not a readable YAML file", where=path, got=str(error)) from error
    content = {} if content is None else content
    if not isinstance(content, dict):
        raise InputError("wrong type", where=path, got=f"a {type(content).__name__}", expected="a mapping")
    return {str(key): value for key, value in content.items()}


def read_json(text: str, where: str) -> Any:
    """The document in a JSON text. Raises InputError: not JSON, a key given twice, a number that is not finite."""

    def refuse_constant(name: str) -> Any:
        raise InputError("not a finite number", where=where, got=name, expected="finite numbers only")

    def refuse_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        keys = [key for key, _ in pairs]
        if twice := sorted({key for key in keys if keys.count(key) > 1}):
            raise InputError("key given twice", where=where, got=", ".join(twice), expected="each key once")
        return dict(pairs)

    try:
        return json.loads(text, parse_constant=refuse_constant, object_pairs_hook=refuse_duplicates)
    except InputError:
        raise
    except (ValueError, RecursionError) as error:
        raise InputError(f"malformed JSON ({error})", where=where) from error
