"""Elements of a URDF that several others have: the file as XML, numbers, origins, masses."""

from __future__ import annotations

import codecs
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from armsight.arrays import Array
from armsight.errors import BadFile
from armsight.store.interpret import looks_like_degrees
from armsight.store.tables import plain_float

DECLARED = re.compile(rb"""^\s*(?:<!--.*?-->\s*)*<\?xml\s[^>]*?encoding\s*=\s*["']([\w.:-]{1,40})["']""", re.DOTALL)
DECLARATION = re.compile(r"<\?xml\s[^>]*\?>")
KNOWN_ENCODINGS = re.compile(
    r"utf-?8|utf-?16(-?[lb]e)?|us-ascii|ascii|latin-?1|iso-?8859-\d+|(windows-|cp)125\d|gb(2312|k|18030)|big5|"
    r"shift[_-]jis|euc-(jp|kr)|koi8-[ru]",
    re.IGNORECASE,
)
"""Those that keep the signs of XML where ASCII has them (or are Unicode), so that nothing is hidden from the checks."""

EXPAND = "Expand it first: xacro ROBOT.urdf.xacro > ROBOT.urdf"

DEEPEST = 100
"""Elements within elements; a robot's description has six."""


def text_of(data: bytes, where: str) -> str:
    """Return an XML file's text in the encoding that its mark or its first line names, else UTF-8; else BadFile."""
    named = DECLARED.match(data[:2000])
    encoding = named[1].decode() if named else "utf-8"
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encoding = "utf-16"
    elif data.startswith(codecs.BOM_UTF8):
        encoding = "utf-8-sig"
    elif not KNOWN_ENCODINGS.fullmatch(encoding):
        raise BadFile(
            f"{where}: says that it is written in {encoding!r}, which is not known here", cure="Save it as UTF-8"
        )
    try:
        return data.decode(encoding)
    except (UnicodeDecodeError, LookupError) as error:
        raise BadFile(
            f"{where}: is not {encoding.removesuffix('-sig').upper()} text",
            cure='Save it as UTF-8, or name its encoding in the first line: <?xml version="1.0" encoding="latin1"?>',
        ) from error


def root_of(text: str, where: str) -> ElementTree.Element:
    """Return the robot element of a URDF's text.

    Prefixes stay part of the names and need no declaration, a default namespace is none, and what stands before the
    first element does not matter. Raises BadFile for what is no URDF.
    """
    if "\0" in text:
        raise BadFile(f"{where}: holds zeros", cure="Save it as UTF-8")
    try:
        root = _Reader(where).read(DECLARATION.sub("", text.removeprefix("\ufeff"), count=1).strip())
    except (expat.ExpatError, ValueError, AssertionError) as error:
        raise BadFile(f"{where}: is not XML ({error})", cure="Give the file that xacro has expanded") from error
    if root.tag != "robot":
        raise BadFile(f"{where}: its root is <{root.tag[:40]}>, not <robot>", cure="Give a URDF file")
    _check_expanded(root, where)
    return root


class _Reader:
    """A parser without namespaces that refuses deep files and declarations, before it reads on."""

    def __init__(self, where: str) -> None:
        self._where, self._depth = where, 0
        self._tree = ElementTree.TreeBuilder()

    def read(self, text: str) -> ElementTree.Element:
        """Return the root. Raises BadFile, and what parser and builder raise."""
        parser = expat.ParserCreate()
        parser.StartElementHandler, parser.EndElementHandler = self._start, self._end
        parser.StartDoctypeDeclHandler = self._document_type
        parser.Parse(text, True)
        return self._tree.close()

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        self._depth += 1
        if self._depth > DEEPEST:
            raise BadFile(
                f"{self._where}: its elements are nested {DEEPEST} deep",
                consequence="It is no robot's description",
                cure="Give a URDF file",
            )
        self._tree.start(name, attributes)

    def _end(self, name: str) -> None:
        self._depth -= 1
        self._tree.end(name)

    def _document_type(self, _: str, system: str | None, public: str | None, internal: bool) -> None:
        if system or public or internal:
            raise BadFile(
                f"{self._where}: holds a document type with entities, or one of another file",
                consequence="It is not read: they could expand without end",
                cure="Remove the <!DOCTYPE ...> part",
            )


def _check_expanded(root: ElementTree.Element, where: str) -> None:
    raw = next((element.tag for element in root if element.tag.startswith("xacro:")), None)
    if raw is not None:
        raise BadFile(
            f"{where}: is a xacro file: it holds <{raw[:60]}>", consequence="Its links are not made yet", cure=EXPAND
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mass:
    """What a link weighs, and its centre of mass (3,) in the link's frame."""

    kg: float
    com_m: Array


def inertials(root: ElementTree.Element) -> Mapping[str, ElementTree.Element]:
    """Return the inertial elements of the links that weigh something, by the link's name."""
    found = {str(link.get("name")): link.find("inertial") for link in root.findall("link")}
    return {name: inertial for name, inertial in found.items() if inertial is not None and len(inertial)}


def mass_of(inertial: ElementTree.Element, at: str) -> Mass | None:
    """Return a link's mass, None where it has none; BadFile where it is no mass. How its inertia is turned is nothing
    to the weight."""
    mass = inertial.find("mass")
    if mass is None:
        return None
    kg = float(numbers(mass.get("value"), "", 1, f"{at}: mass")[0])
    if kg < 0.0:
        raise BadFile(
            f"{at}: mass is {kg:g} kg",
            consequence="How the arm sags under its weight is not known",
            cure="Correct it, or remove this link's <inertial>",
        )
    origin = inertial.find("origin")
    return Mass(kg=kg, com_m=numbers(None if origin is None else origin.get("xyz"), "0 0 0", 3, f"{at}: origin xyz"))


def together(parts: Sequence[tuple[Array, Mass]]) -> Mass:
    """Return several masses as one, each with the place (4, 4) of its link."""
    kg = sum(mass.kg for _, mass in parts)
    if not kg > 0.0:
        return Mass(kg=0.0, com_m=np.zeros(3))
    moment = sum((mass.kg * (T[:3, :3] @ mass.com_m + T[:3, 3]) for T, mass in parts), np.zeros(3))
    return Mass(kg=kg, com_m=moment / kg)


def origin_of(element: ElementTree.Element, at: str) -> Array:
    """Return the (4, 4) matrix of an element's origin; the identity where it has none."""
    origin = element.find("origin")
    xyz = numbers(origin.get("xyz") if origin is not None else None, "0 0 0", 3, f"{at}: origin xyz")
    rpy = numbers(origin.get("rpy") if origin is not None else None, "0 0 0", 3, f"{at}: origin rpy")
    if looks_like_degrees(rpy):
        raise BadFile(
            f"{at}: origin rpy {' '.join(f'{value:g}' for value in rpy)} looks like degrees",
            consequence="Taken as URDF means it the arm would be another",
            cure=f"Write radians: {' '.join(f'{value:.10g}' for value in np.deg2rad(rpy))}",
        )
    return matrix(xyz, rpy)


def numbers(text: str | None, default: str, count: int, what: str, *, endless: bool = False) -> Array:
    """Return so many numbers from an attribute, finite ones unless endless."""
    try:
        values = np.array([plain_float(part) for part in (text if text is not None else default).split()])
    except ValueError:
        values = np.empty(0)
    if len(values) != count or not (np.isfinite(values) | (endless & ~np.isnan(values))).all():
        form = "a finite number" if count == 1 else f"{count} finite numbers with blanks between them"
        raise BadFile(
            f"{what} is {str(text)[:40]!r}, not {form}",
            cure=EXPAND if "${" in str(text) else f"Write {form}, such as {' '.join(['0.1', '0', '0.25'][:count])}",
        )
    return values


def matrix(xyz: Array, rpy: Array) -> Array:
    """Return the (4, 4) matrix of an origin: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    T = np.eye(4)
    T[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    T[:3, 3] = xyz
    return T
