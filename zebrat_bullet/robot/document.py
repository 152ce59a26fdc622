"""From a URDF or xacro file to a tree that holds only what a car is made of, every number and reference checked."""

import io
import math
import os
from collections.abc import Mapping
from pathlib import Path

import yourdfpy
from lxml import etree

from zebrat_bullet.errors import RobotError
from zebrat_bullet.files import MB, read_bytes, refusing, shown
from zebrat_bullet.robot.mesh_files import collada_unit_m, mesh_file
from zebrat_bullet.robot.model import TYRE_GRIP
from zebrat_bullet.robot.setup import RobotSetup

_NUMBERS = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "mesh": {"scale": 3},
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
}
_REQUIRED = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",), "mesh": ("filename",)}
_REQUIRED |= {"mass": ("value",)}
_SHAPES = ("box", "cylinder", "sphere", "mesh")
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
        self._leave_friction_out()
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
        """Name meshes by absolute paths, in metres; what is not read is dropped where only visual, else a problem."""
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                self._check_geometry(link, shape)
                continue
            file = mesh_file(self.path, mesh.get("filename") or "")
            if file is not None:
                mesh.set("filename", str(file))
                self._scale_to_metres(mesh, file)
                continue
            said = f"link {link.get('name')}: no mesh at {shown(mesh.get('filename'))}"
            if shape.tag == "visual":
                self._unpainted.append(f"{link.get('name')} ({shown(mesh.get('filename'))})")
            else:
                self.problems.append(f"{said}; put it there, or give <collision> a box")
            link.remove(shape)

    def _check_geometry(self, link: etree._Element, shape: etree._Element) -> None:
        geometry = shape.find("geometry")
        tags = [] if geometry is None else [shown(inner.tag) for inner in geometry]
        if not tags:
            self.notes.append(f"link {link.get('name')}: a <{shape.tag}> without geometry was left out")
        elif tags[0] in _SHAPES:
            return
        elif shape.tag == "visual":
            self.notes.append(f"link {link.get('name')}: a painted <{tags[0]}> is not read and was left out")
        else:
            self.problems.append(
                f"link {link.get('name')}: <{tags[0]}> is not read; write {', '.join(_SHAPES[:-1])} or {_SHAPES[-1]}"
            )
        link.remove(shape)

    def _leave_friction_out(self) -> None:
        """Note a grip that is not the simulators' own: PyBullet alone would obey it, so none does."""
        grips = {name: link.find("contact/lateral_friction") for name, link in self.links.items()}
        written = {name: shown(grip.get("value")) for name, grip in grips.items() if grip is not None}
        others = {name: text for name, text in written.items() if _numbers(text) != [TYRE_GRIP]}
        if others:
            self.notes.append(
                f"the lateral_friction of {', '.join(others)} ({', '.join(dict.fromkeys(others.values()))}) is left "
                f"out: tyres grip the floor by {TYRE_GRIP:g} in every simulator (task.disturbance.friction varies it)"
            )

    def _scale_to_metres(self, mesh: etree._Element, file: Path) -> None:
        """Take the unit of a COLLADA file into its scale, as RViz and Gazebo do: no reader of meshes here does."""
        unit = collada_unit_m(file) if file.suffix.lower() == ".dae" else 1.0
        if unit == 1.0:
            return
        scale = _numbers(mesh.get("scale")) or [1.0] * 3
        mesh.set("scale", " ".join(repr(unit * value) for value in scale))
        said = f"{file.name} is written in units of {unit:g} m, and scaled so"
        if said not in self.notes:
            self.notes.append(said)

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
    elif setup.xacro:
        names = ", ".join(map(shown, setup.xacro))
        raise RobotError(f"{shown(path)}: is no xacro file, so it takes no arguments, got {names}; leave them out")
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
        given = _Arguments(setup.xacro)
        try:
            doc = XacroDoc.from_file(setup.path, subargs=given, resolve_packages=False)
            robot = etree.fromstring(doc.to_urdf_string().encode(), etree.XMLParser(**_PARSER))
        finally:
            os.chdir(here)
    if unused := [name for name in setup.xacro if name not in given.asked]:
        there = ", ".join(sorted(given.asked)) or "none"
        raise RobotError(
            f"{shown(setup.path)}: has no <xacro:arg> {shown(', '.join(unused))}; those there are: {there}; correct "
            "xacro.NAME=VALUE"
        )
    return robot


class _Arguments(dict[str, str]):
    """Arguments of a xacro file that remember which the file and its includes ask for."""

    def __init__(self, given: Mapping[str, str]) -> None:
        super().__init__(given)
        self.asked: set[str] = set()

    def __contains__(self, name: object) -> bool:
        self.asked.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.asked.add(name)
        return super().__getitem__(name)
