"""A made-up robot's package, in the layout of linorobot."""

from pathlib import Path

import pytest

FILES = {
    "package.xml": "<package>\n  <name>linorobot</name>\n</package>\n",
    "launch/bringup.launch": """\
<launch>
    <node pkg="rosserial_python" name="rosserial_lino" type="serial_node.py" output="screen">
        <param name="port" value="/dev/linobase" />
        <param name="baud" value="57600" />
    </node>
    <node pkg="tf2_ros" type="static_transform_publisher" name="base_footprint_to_base_link"
          args="0 0 0.05 0 0 0  /base_footprint /base_link"/>
    <include file="$(find linorobot)/launch/include/laser.launch" />
</launch>
""",
    "launch/include/laser.launch": """\
<launch>
    <include file="$(find linorobot)/launch/include/lidar/$(env LINOLIDAR).launch" />
    <node pkg="tf2_ros" type="static_transform_publisher" name="base_link_to_laser"
          args="0.07 -0.01 0.1 0.5 0 0  /base_link /laser"/>
</launch>
""",
    "launch/include/lidar/xv11.launch": """\
<launch>
    <node pkg="xv_11_laser_driver" type="neato_laser_publisher" name="xv11">
        <param name="port" value="/dev/linolidar"/>
        <param name="baud_rate" value="115200"/>
    </node>
</launch>
""",
    "launch/include/lidar/rplidar.launch": """\
<launch>
    <node name="rplidarNode" pkg="rplidar_ros" type="rplidarNode" output="screen">
        <param name="serial_port" type="string" value="/dev/linolidar"/>
        <param name="serial_baudrate" type="int" value="115200"/>
    </node>
</launch>
""",
    "launch/include/lidar/ydlidar.launch": """\
<launch>
    <node name="ydlidar_node" pkg="ydlidar" type="ydlidar_node">
        <param name="port" value="/dev/linolidar"/>
        <param name="baudrate" value="115200"/>
    </node>
</launch>
""",
    "launch/navigate.launch": """\
<launch>
    <arg name="map_file" default="$(find linorobot)/maps/house.yaml"/>
    <node pkg="map_server" name="map_server" type="map_server" args="$(arg map_file)" />
    <include file="$(find linorobot)/launch/include/amcl.launch" />
    <include file="$(find linorobot)/launch/include/move_base/move_base_$(env LINOBASE).launch" />
</launch>
""",
    "launch/include/amcl.launch": """\
<launch>
    <node pkg="amcl" type="amcl" name="amcl" output="screen">
        <param name="min_particles" value="500"/>
        <param name="initial_pose_x" value="0.548767569629"/>
        <param name="initial_pose_y" value="0.218281839179"/>
        <param name="initial_pose_z" value="0.0"/>
        <param name="initial_orientation_z" value="0.128591756735"/>
        <param name="initial_orientation_w" value="0.991697615254"/>
    </node>
</launch>
""",
    "launch/include/move_base/move_base_2wd.launch": """\
<launch>
    <arg name="params" default="$(find linorobot)/param/navigation"/>
    <node pkg="move_base" type="move_base" name="move_base">
        <rosparam file="$(arg params)/costmap_common_params.yaml" command="load" ns="x" />
        <rosparam file="$(arg params)/base_local_planner_default_params.yaml" command="load" />
    </node>
</launch>
""",
    "param/navigation/costmap_common_params.yaml": """\
obstacle_range: 2.5
footprint: [[-0.16, -0.11], [-0.16, 0.11], [0.16, 0.11], [0.16, -0.11]]
inflation_radius: 0.3
scan:
  topic: scan
""",
    "param/navigation/base_local_planner_default_params.yaml": """\
TrajectoryPlannerROS:
  max_vel_x: 0.35
  max_vel_theta: 0.5
  min_in_place_vel_theta: 0.6
""",
    "maps/house.yaml": """\
image: house.pgm
resolution: 0.05
origin: [-1.0, -0.5, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
""",
}


class Package:
    """The package's folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name, text in FILES.items():
            self.write(name, text)
        self.path("maps/house.pgm").write_bytes(b"P5\n40 20\n255\n" + bytes([254]) * 800)

    def path(self, name: str) -> Path:
        return self.folder / name

    def write(self, name: str, text: str) -> None:
        self.path(name).parent.mkdir(parents=True, exist_ok=True)
        self.path(name).write_text(text, encoding="utf-8")

    def change(self, name: str, old: str, new: str) -> None:
        text = FILES[name]
        assert old in text
        self.write(name, text.replace(old, new))


@pytest.fixture
def package(tmp_path: Path) -> Package:
    return Package(tmp_path / "linorobot")
