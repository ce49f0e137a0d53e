"""Expansion of xacro macros, with the packages and the arguments of one description."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain, count
from pathlib import Path
from threading import Lock
from typing import Any
from xml.dom.minidom import Document, parseString

from pinposture._validation import is_number, require_known
from pinposture.arm.expressions import Expressions
from pinposture.arm.packages import find_packages, package_folders, package_name
from pinposture.arm.urdf import is_urdf_text, parse_xml
from pinposture.errors import FileError, InvalidValue, PostureError, URDFError, install
from pinposture.storage import read_xml

logger = logging.getLogger(__name__)


MACROS = "http://www.ros.org/wiki/xacro"
"""The namespace of xacro."""

MOST_ELEMENTS = 100_000
"""Most elements to which macros may expand: xacro takes 2 s for 32,000, and minutes for 300,000."""

_PARAMETER = re.compile(
    r"""^\s*([^\s:=]+?)\s*:?=\s*(\^\|?)?(\$\{.*?\}|\$\(.*?\)|(?:'[^']*'|"[^"]*"|[^\s'"])+|)(?:\s+|$)(.*)"""
)  # a parameter of a macro as in xacro, whose own pattern takes time exponential in the length of a default
_LOCK = Lock()  # xacro keeps the state of an expansion in its modules


class Arguments(dict[str, str]):
    """The arguments of a description, by name, which remembers those that the description asks for.

    Attributes:
        asked: names that it declares or uses, also where a condition leaves that out.
        missing: the first that it uses without a value.
    """

    def __init__(self, values: Mapping[str, str]) -> None:
        super().__init__(values)
        self.asked: dict[str, None] = {}
        self.missing: str | None = None

    def __contains__(self, name: object) -> bool:
        self.asked[str(name)] = None
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.asked[name] = None
        return super().__getitem__(name)

    def look_through(self, text: str) -> None:
        """Add the names in a file to those that are asked for."""
        pattern = r"""<xacro:arg\s[^<>]*?\bname\s*=\s*["']([^"']+)|\$\(arg\s+([^\s()]+)"""
        for declared, used in re.findall(pattern, text):
            self.asked[declared or used] = None

    def __missing__(self, name: str) -> str:
        self.missing = self.missing or name
        raise KeyError(name)


class Substituted(dict[str, Any]):
    """What $(eval ...) may name: functions, and the arguments of a description as numbers or text.

    Attributes:
        arguments: the arguments.
    """

    def __init__(self, arguments: Arguments, functions: Mapping[str, Any]) -> None:
        super().__init__(functions)
        self.arguments = arguments

    def __missing__(self, name: str) -> Any:
        from xacro.substitution_args import convert_value

        return convert_value(self.arguments[name], "auto")


def read_arguments(arguments: object) -> dict[str, str]:
    """Return xacro arguments as text; raise InvalidValue unless they are numbers, truth values or text."""
    allowed = "a mapping from names of arguments to text, numbers or truth values, or None"
    if arguments is None:
        return {}
    if not isinstance(arguments, Mapping):
        raise InvalidValue("xacro_args", arguments, allowed)
    read: dict[str, str] = {}
    for name, value in arguments.items():
        if not isinstance(name, str) or not name.strip():
            raise InvalidValue("xacro_args", arguments, allowed)
        if isinstance(value, bool):
            read[name] = str(value).lower()
        elif isinstance(value, str) or is_number(value):
            read[name] = str(value)
        else:
            raise InvalidValue(f"xacro_args.{name}", value, "text, a number or a truth value")
    return read


def expand_macros(
    source: str | Path,
    arguments: Mapping[str, str],
    folders: Sequence[Path] = (),
    defaults: Mapping[str, str] | None = None,
) -> str:
    """Expand the macros of xacro.

    Args:
        source: path of a file, or text.
        arguments: values of its arguments, by name.
        folders: where to search for packages, before the folders above the file and the environment.
        defaults: values of arguments that the source need not have.

    Returns:
        URDF text.

    Raises:
        FileError: the file, or one that it includes, is missing or cannot be expanded; a package is missing.
        UnknownName: the source does not ask for an argument.
        URDFError: malformed XML, an argument without a value, or no links.
    """
    path = None if is_urdf_text(source) else Path(source)
    text = str(source) if path is None else read_xml(path)
    label = "xacro text" if path is None else str(path)
    known = Arguments({**(defaults or {}), **arguments})
    try:
        import xacro
    except ImportError:
        raise FileError(label, f"cannot be expanded without xacro: {install('descriptions')}") from None
    try:
        with _LOCK, _adapted(xacro, known, folders):
            xacro.init_stacks(None if path is None else str(path))
            document = _parsed(text, label, known)
            xacro.process_doc(document, mappings=known)
    except PostureError:
        raise
    except Exception as error:  # from the macros, or from Python code in them
        _blame(error, label, known)
        raise FileError(label, f"cannot be expanded ({one_line(error)})") from error
    for name in arguments:
        require_known("xacro argument", name, sorted(known.asked))
    root: Any = document.documentElement
    _require_links(root, label, known)
    for attribute in [name for name, value in root.attributes.items() if value == MACROS]:
        root.removeAttribute(attribute)  # so that nobody expands it again
    return str(document.toxml())


def _blame(error: BaseException, label: str, arguments: Arguments) -> None:
    """Raise a clear error if one of this package is behind that of xacro, or an argument is missing."""
    if arguments.missing is not None:
        name = arguments.missing
        advice = f"pass one, as by xacro_args={{{name!r}: ...}} (--xacro-arg {name}:=...)"
        reason = f"has no value and no default; {advice}"
        raise URDFError(label, f"xacro argument {name!r}", reason) from error
    behind: BaseException | None = error
    while behind is not None:
        if isinstance(behind, URDFError):
            raise behind from error
        if isinstance(behind, PostureError):
            raise FileError(label, f"cannot be expanded: {behind}") from error
        behind = getattr(behind, "exc", None) or behind.__cause__


def _require_links(root: Any, label: str, arguments: Arguments) -> None:
    """Raise URDFError for a robot without links, which depend on arguments or are those of macros."""
    if root.tagName != "robot" or any(getattr(node, "tagName", "") == "link" for node in root.childNodes):
        return
    reason = "has no links once its macros are expanded"
    if arguments:
        shown = ", ".join(f"{name}:={value}" for name, value in arguments.items())
        advice = "pass others, as by xacro_args={...} (--xacro-arg NAME:=VALUE)"
        reason += f" with the arguments {shown}; {advice}"
    else:
        reason += "; load the file that calls the macros"
    raise URDFError(label, "<robot>", reason)


def _parsed(text: str, label: str, arguments: Arguments) -> Document:
    parse_xml(text, label)  # raises clear errors, and refuses entities
    arguments.look_through(text)
    document: Document = parseString(text.lstrip("\ufeff \t\r\n"))
    return document


def _find_package(folders: Sequence[Path], reading: Sequence[str | None]) -> Callable[[str], str]:
    """Return the function that finds packages: in folders, above the files being read, in the environment."""

    def find(name: str) -> str:
        files = [Path(file).absolute().parent for file in reversed(reading) if file]
        searched = package_folders(())
        packages = chain(find_packages(name, folders, files), find_packages(name, searched))
        unnamed = None  # a folder of that name that is no package
        for folder in packages:
            if package_name(folder) == name:
                return str(folder)
            if unnamed is None and folder.is_dir():
                unnamed = folder
        if unnamed is not None:
            return str(unnamed)
        searched = [*folders, *dict.fromkeys(files), *searched]
        where = ", ".join(map(str, searched)) or "no folder"
        advice = "pass its folder as package_dirs=[...] (--package-dir)"
        raise FileError(f"$(find {name})", f"no such package (searched: {where}); {advice}")

    return find


@contextmanager
def _adapted(xacro: Any, arguments: Arguments, folders: Sequence[Path]) -> Iterator[None]:
    """Let xacro find packages without ROS, read any encoding, evaluate within bounds, and log, not print."""
    from xacro import color, substitution_args

    def find(name: str) -> str:
        return _find_package(folders, xacro.filestack)(name)

    def parse(text: Any, filename: str | None = None) -> Any:
        if text is not None or filename is None:
            return text
        path = Path(xacro.root_dir, filename)
        try:
            return _parsed(read_xml(path), str(path), arguments)
        except FileError as error:
            if path.is_file():
                raise
            xacro.filestack.pop()  # it is not being read
            raise xacro.XacroException(str(error), exc=error) from error  # which "optional" includes catch

    def read() -> str:
        return str(xacro.filestack[-1] or "xacro text")

    expressions = Expressions(read)
    evaluate = xacro.eval_all
    evaluated = count(1)

    def evaluate_elements(node: Any, macros: Any, symbols: Any) -> None:
        if next(evaluated) > MOST_ELEMENTS:
            reason = f"expands to more than {MOST_ELEMENTS} elements; call fewer macros in macros"
            raise URDFError(read(), "<robot>", reason)
        with expressions.naming(node.tagName):
            expressions.spend(len(node.childNodes))
        evaluate(node, macros, symbols)

    evaluate_pieces = xacro.eval_text

    def evaluate_text(text: str, symbols: Any) -> Any:
        if "$" not in text:
            return text
        with expressions.naming(text):
            expressions.spend(len(text) * (1 + text.count("$") // 100))  # each piece cuts what is left of it
            return expressions.checked(evaluate_pieces(text, symbols))

    substituted = expressions.functions(substitution_args._eval_dict, xacro.NameSpace)

    def evaluate_argument(text: str, context: dict[str, Any]) -> str:
        return str(expressions.evaluate(text, Substituted(arguments, substituted)))

    def log(*words: object, **_: object) -> None:
        logger.warning(" ".join(map(str, words)))

    replaced: list[tuple[dict[str, Any], str, Any]] = [
        (vars(substitution_args), "_eval_find", find),
        (substitution_args._eval_dict, "find", find),
        (vars(substitution_args), "_eval", evaluate_argument),
        (vars(xacro), "parse", parse),
        (vars(xacro), "eval_all", evaluate_elements),
        (vars(xacro), "eval_text", evaluate_text),
        (vars(xacro), "safe_eval", expressions.evaluate),
        (vars(xacro), "_global_symbols", expressions.functions(xacro._global_symbols, xacro.NameSpace)),
        (vars(xacro), "re_macro_arg", _PARAMETER),
        (vars(xacro), "print", log),
        (vars(color), "print", log),
    ]
    nothing = object()
    before = [table.get(name, nothing) for table, name, _ in replaced]
    for table, name, value in replaced:
        table[name] = value
    try:
        yield
    finally:
        for (table, name, _), value in zip(replaced, before, strict=True):
            if value is nothing:
                del table[name]
            else:
                table[name] = value


def one_line(error: Exception) -> str:
    """Return the kind and the message of an exception on one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())
