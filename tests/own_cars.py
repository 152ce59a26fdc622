"""URDFs as others write them, made here: a car of 0.45 x 0.30 m, of which each test varies what it is about."""

from dataclasses import dataclass, field
from pathlib import Path

ROS_JOINTS = {
    "left_steering_hinge_joint": "front_left_steer",
    "right_steering_hinge_joint": "front_right_steer",
    "left_rear_wheel_joint": "rl_wheel",
    "right_rear_wheel_joint": "rr_wheel",
    "left_front_wheel_joint": "fl_wheel",
    "right_front_wheel_joint": "fr_wheel",
    "lidar_mount": "laser",
}
"""Names as in ROS packages; the lidar is a link."""


@dataclass(kw_only=True)
class OwnCar:
    """A car in XML; every text can be replaced. Its base frame stands on the floor, midway between the axles."""

    names: dict[str, str] = field(default_factory=lambda: {role: role for role in ROS_JOINTS})
    root: str = '<link name="base_link">{inertial}{collision}</link>'
    inertial: str = (
        '<inertial><origin xyz="0 0 0.1"/><mass value="4"/>'
        '<inertia ixx="0.03" ixy="0" ixz="0" iyy="0.07" iyz="0" izz="0.1"/></inertial>'
    )
    collision: str = '<collision><origin xyz="0 0 0.12"/><geometry><box size="0.45 0.30 0.12"/></geometry></collision>'
    wheel: str = (
        '<collision><origin rpy="1.5707963 0 0"/><geometry><cylinder radius="0.05" length="0.03"/></geometry>'
        "</collision>"
    )
    wheel_inertial: str = (
        '<inertial><mass value="0.3"/><inertia ixx="2e-4" ixy="0" ixz="0" iyy="4e-4" iyz="0" izz="2e-4"/></inertial>'
    )
    wheel_origin: str = ""
    wheel_axis: str = "0 1 0"
    wheel_limit: str = '<limit effort="2" velocity="60"/>'
    hinge_type: str = "revolute"
    hinge_axis: str = "0 0 1"
    hinge_rpy: str = "0 0 0"
    hinge_limit: str = '<limit lower="-0.9" upper="0.9" effort="5" velocity="6"/>'
    front_wheel_xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    half_front: float = 0.12
    half_rear: float = 0.12
    half_base: float = 0.16
    wheel_z: float = 0.05
    lidar: str = '<origin xyz="0.1 0 0.25"/>'
    more: str = ""

    def urdf(self) -> str:
        """Return its text."""
        parts = [self.root.format(inertial=self.inertial, collision=self.collision)]
        for side, sign in (("left", 1), ("right", -1)):
            x, y, z = self.front_wheel_xyz
            parts += [
                self._wheel(f"{side}_rear", "base_link", (-self.half_base, sign * self.half_rear, self.wheel_z)),
                f'<link name="{side}_knuckle"/>',
                self._joint(f"{side}_steering_hinge_joint", self.hinge_type, "base_link", f"{side}_knuckle",
                            (self.half_base, sign * self.half_front, self.wheel_z), self.hinge_rpy, self.hinge_axis,
                            self.hinge_limit),
                self._wheel(f"{side}_front", f"{side}_knuckle", (x, sign * y, z)),
            ]  # fmt: skip
        name = self.names["lidar_mount"]
        link, joint = (name, "laser_joint") if name == "laser" else ("scanner", name)
        parts.append(
            f'<link name="{link}"/><joint name="{joint}" type="fixed"><parent link="base_link"/>'
            f'<child link="{link}"/>{self.lidar}</joint>'
        )
        return f'<?xml version="1.0"?>\n<robot name="own">{"".join(parts)}{self.more}</robot>'

    def _wheel(self, where: str, parent: str, at: tuple[float, float, float]) -> str:
        link = f'<link name="{where}_wheel">{self.wheel_inertial}{self.wheel}</link>'
        joint = self._joint(f"{where}_wheel_joint", "continuous", parent, f"{where}_wheel", at,
                            self.wheel_origin or "0 0 0", self.wheel_axis, self.wheel_limit)  # fmt: skip
        return link + joint

    def _joint(
        self,
        role: str,
        kind: str,
        parent: str,
        child: str,
        at: tuple[float, float, float],
        rpy: str,
        axis: str,
        limit: str,
    ) -> str:
        return (
            f'<joint name="{self.names[role]}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{at[0]} {at[1]} {at[2]}" rpy="{rpy}"/><axis xyz="{axis}"/>{limit}</joint>'
        )

    def write(self, folder: Path, name: str = "own.urdf") -> Path:
        """Write it into a folder."""
        path = folder / name
        path.write_text(self.urdf(), encoding="utf-8")
        return path
