"""The dialect of YAML in which people write their files."""

import re
from collections import Counter
from typing import IO, Any

import yaml
from yaml import YAMLError

__all__ = ["YAMLError", "parse_yaml"]


def parse_yaml(file: IO[bytes]) -> Any:
    """The document in ``file``. Raises YAMLError: no YAML, a key given twice, a tag that would make an object."""
    return yaml.load(file, _Loader)


class _Loader(yaml.CSafeLoader):
    """Fractions as in YAML 1.2, where 1e-3 is one; a date is a text; no key twice."""

    yaml_implicit_resolvers = {  # noqa: RUF012
        first: [(tag, form) for tag, form in resolvers if not tag.endswith((":timestamp", ":float"))]
        for first, resolvers in yaml.CSafeLoader.yaml_implicit_resolvers.items()
    }

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = Counter(key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode))
        if twice := sorted(key for key, times in keys.items() if times > 1):
            raise yaml.MarkedYAMLError(problem=f"key given twice: {', '.join(twice)}", problem_mark=node.start_mark)
        return super().construct_mapping(node, deep)


_FLOAT = re.compile(
    r"""(?:[-+]?(?:\.[0-9]+|[0-9]+\.[0-9]*)(?:[eE][-+]?[0-9]+)?
        | [-+]?[0-9]+[eE][-+]?[0-9]+
        | [-+]?\.(?:inf|Inf|INF)
        | \.(?:nan|NaN|NAN))$""",
    re.VERBOSE,
)
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", _FLOAT, list("-+0123456789."))
