"""From a URDF or xacro file to a tree that holds only what a car is made of, every number and reference checked."""

import io
import math
import os
import re
from collections.abc import Iterator
from pathlib import Path

import yourdfpy
from lxml import etree

from zebrat_bullet.errors import RobotError
from zebrat_bullet.files import MB, is_file, read_bytes, refusing, shown
from zebrat_bullet.robot.setup import RobotSetup

_NUMBERS = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "capsule": {"radius": 1, "length": 1},
    "mesh": {"scale": 3},
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
}
_REQUIRED = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",), "mesh": ("filename",)}
_REQUIRED |= {"capsule": _REQUIRED["cylinder"], "mass": ("value",)}
_MOST_LINKS = 1000
_PARSER = {"resolve_entities": False, "no_network": True, "remove_comments": True, "remove_pis": True}


class Document:
    """The tree of a URDF.

    Attributes:
        path: the file.
        robot: its root element; meshes are named by absolute paths, those that are nowhere to be found are dropped.
        links, joints: elements by name.
        parent_of: name of the joint above each link.
        root: name of the root link.
        problems: what forbids to use it, each with its mend.
        notes: what was left out.
    """

    def __init__(self, setup: RobotSetup) -> None:
        self.path = setup.path
        self.problems: list[str] = []
        self.notes: list[str] = []
        self.robot = _read(setup)
        self.links = self._named("link")
        self.joints = self._named("joint")
        self._check_tree()
        for element in [*self.links.values(), *self.joints.values()]:
            self._check_numbers(element)
        self._unpainted: list[str] = []
        for link in self.links.values():
            self._find_meshes(link)
        if self._unpainted:
            self.notes.append(f"meshes that are only painted were not found and left out: {', '.join(self._unpainted)}")

    def _named(self, tag: str) -> dict[str, etree._Element]:
        found: dict[str, etree._Element] = {}
        for element in self.robot.findall(tag):
            name = element.get("name")
            if not name or len(name) > 200:
                self._refuse(f"a {tag} has the name {shown(name)!r}; give it one of up to 200 letters")
            if name in found:
                self._refuse(f"two {tag}s are named {name}; give each its own name")
            found[name] = element
        return found

    def _refuse(self, problem: str) -> None:
        raise RobotError(f"{shown(self.path)}: {problem}")

    def _check_tree(self) -> None:
        """Raise unless the joints make one tree of the links: nothing else can be said of what is no tree."""
        if not self.links:
            self._refuse("holds no links; a URDF is <robot> with <link> and <joint>")
        if len(self.links) > _MOST_LINKS:
            self._refuse(f"holds {len(self.links)} links, {_MOST_LINKS} at most; leave out what is no part of a car")
        self.parent_of: dict[str, str] = {}
        for name, joint in self.joints.items():
            for end in ("parent", "child"):
                element = joint.find(end)
                link = None if element is None else element.get("link")
                if link not in self.links:
                    self._refuse(f"joint {name} has the {end} link {shown(link)!r}, which is not there; name one")
            child = joint.find("child").get("link")
            if child in self.parent_of:
                self._refuse(f"link {child} hangs on two joints, {self.parent_of[child]} and {name}; leave one")
            self.parent_of[child] = name
        roots = [name for name in self.links if name not in self.parent_of]
        if len(roots) != 1:
            said = f"has the root links {shown(', '.join(roots))}" if roots else "has joints in a loop"
            self._refuse(f"{said}; every link but one must hang on a joint")
        self.root = roots[0]
        for link in self.links:
            seen, at = 0, link
            while at in self.parent_of:
                at, seen = self.joints[self.parent_of[at]].find("parent").get("link"), seen + 1
                if seen > len(self.links):
                    self._refuse(f"link {link} hangs on joints in a loop; every link but one must hang on another")

    def _check_numbers(self, element: etree._Element) -> None:
        """Note every number that is none; it becomes 0 for the rest of the checks."""
        where = f"{element.tag} {element.get('name')}"
        for inner in element.iter(*_NUMBERS):
            for name in _REQUIRED.get(inner.tag, ()):
                if inner.get(name) is None:
                    self.problems.append(f"{where}: <{inner.tag}> lacks {name}; write it")
                    inner.set(name, " ".join(["1"] * _NUMBERS[inner.tag].get(name, 1)))
            for name, count in _NUMBERS[inner.tag].items():
                text = inner.get(name)
                values = None if text is None else _numbers(text)
                if inner.tag == "mesh" and values is not None and len(values) in (1, 4):
                    values = (values * 3)[:3] if len(values) == 1 else values[:3]
                    inner.set(name, " ".join(map(repr, values)))
                if text is not None and (values is None or len(values) != count):
                    numbers = "a finite number" if count == 1 else f"{count} finite numbers"
                    self.problems.append(f"{where}: {name} of <{inner.tag}> must be {numbers}, got {shown(text)!r}")
                    inner.set(name, " ".join(["0"] * count))
                elif inner.tag in ("box", "cylinder", "sphere") and values is not None and min(values) < 0:
                    self.problems.append(f"{where}: {name} of <{inner.tag}> must be above 0, got {text}")
        for mass in element.iter("mass"):
            if (_numbers(mass.get("value")) or [0.0])[0] < 0:
                self.problems.append(f"{where}: mass must be at least 0, got {mass.get('value')}")

    def _find_meshes(self, link: etree._Element) -> None:
        """Name meshes by absolute paths; one that is missing is dropped where only visual, else a problem."""
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                if shape.find("geometry") is None or not len(shape.find("geometry")):
                    self.notes.append(f"link {link.get('name')}: a <{shape.tag}> without geometry was left out")
                    link.remove(shape)
                continue
            file = mesh_file(self.path, mesh.get("filename") or "")
            if file is not None:
                mesh.set("filename", str(file))
                continue
            said = f"link {link.get('name')}: no mesh at {shown(mesh.get('filename'))}"
            if shape.tag == "visual":
                self._unpainted.append(f"{link.get('name')} ({shown(mesh.get('filename'))})")
            else:
                self.problems.append(f"{said}; put it there, or give <collision> a box")
            link.remove(shape)

    def urdf(self) -> yourdfpy.URDF:
        """Return the tree as yourdfpy reads it, without meshes.

        Raises:
            RobotError: it cannot.
        """
        with refusing(self.path, RobotError, "cannot be read as a URDF", "check it with check_urdf"):
            return parse_urdf(self.text(), load_meshes=False)

    def text(self) -> str:
        """Return the tree as a URDF."""
        return etree.tostring(self.robot, encoding="unicode")


def parse_urdf(text: str, *, load_meshes: bool) -> yourdfpy.URDF:
    """Return a URDF whose meshes are named by absolute paths as yourdfpy reads it."""
    return yourdfpy.URDF.load(
        io.BytesIO(text.encode()),
        load_meshes=load_meshes,
        build_scene_graph=True,
        filename_handler=lambda fname: fname,
    )


def mesh_file(urdf: Path, name: str) -> Path | None:
    """Return the file of a mesh that a URDF names: relative to it, `file://`, or `package://NAME/...`; None if missing.

    A package is a folder of its name, or one whose package.xml says it, at or beside the URDF's own folder or one
    above it, or where ROS_PACKAGE_PATH, AMENT_PREFIX_PATH and CMAKE_PREFIX_PATH point.
    """
    if name.startswith(("package://", "model://")):
        package, _, inside = name.partition("://")[2].partition("/")
        tried: Iterator[Path] = (folder / inside for folder in _package_folders(urdf, package))
    else:
        tried = iter([urdf.parent / re.sub(r"^file://(localhost)?", "", name)])
    return next((file.resolve() for file in tried if is_file(file)), None)


def _package_folders(urdf: Path, package: str) -> Iterator[Path]:
    for folder in urdf.parents:
        if folder.name == package or _package_name(folder) == package:
            yield folder
        yield folder / package
    for variable in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH"):
        for folder in map(Path, filter(None, os.environ.get(variable, "").split(os.pathsep))):
            yield from (folder / package, folder / "share" / package)


def _package_name(folder: Path) -> str | None:
    file = folder / "package.xml"
    if not is_file(file):
        return None
    match = re.search(rb"<name>\s*([\w.-]+)\s*</name>", read_bytes(file, RobotError, MB))
    return match[1].decode() if match else None


def _numbers(text: str | None) -> list[float] | None:
    try:
        values = [float(word) for word in (text or "").split()]
    except ValueError:
        return None
    return values if values and all(math.isfinite(value) and abs(value) < 1e12 for value in values) else None


def _read(setup: RobotSetup) -> etree._Element:
    path = setup.path
    if path.suffix in (".sdf", ".world", ".xml"):
        with refusing(path, RobotError, "cannot be read as XML", "name a URDF"):
            tag = etree.fromstring(read_bytes(path, RobotError, 16 * MB), etree.XMLParser(**_PARSER)).tag
        if tag != "robot":
            raise RobotError(f"{shown(path)}: is <{shown(tag)}>, not <robot>; only URDF and xacro are read, convert it")
    data = read_bytes(path, RobotError, 16 * MB)
    with refusing(
        path, RobotError, "cannot be read as a URDF", "it must be XML with a <robot>; check it with check_urdf"
    ):
        robot = etree.fromstring(data, etree.XMLParser(**_PARSER))
        if robot.tag != "robot":
            raise ValueError(f"its outermost element is <{shown(robot.tag)}>")
    if any(isinstance(e.tag, str) and "xacro" in (etree.QName(e).namespace or "") for e in robot.iter()):
        robot = _expanded(setup)
    for element in list(robot):
        if element.tag not in ("link", "joint", "material"):
            robot.remove(element)
    return robot


def _expanded(setup: RobotSetup) -> etree._Element:
    try:
        from xacrodoc import XacroDoc
    except ImportError as error:
        raise RobotError(
            f"{shown(setup.path)}: is a xacro file, and the package that expands it is not there; "
            "pip install 'zebrat-bullet[xacro]', or expand it where ROS is: xacro FILE > car.urdf"
        ) from error
    what = "xacro cannot expand it"
    with refusing(setup.path, RobotError, what, "mend it; arguments are given as xacro.NAME=VALUE"):
        here = Path.cwd()
        os.chdir(setup.path.parent)  # where includes by relative names are looked for
        try:
            doc = XacroDoc.from_file(setup.path, subargs=dict(setup.xacro) or None, resolve_packages=False)
            return etree.fromstring(doc.to_urdf_string().encode(), etree.XMLParser(**_PARSER))
        finally:
            os.chdir(here)
