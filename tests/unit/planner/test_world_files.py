"""Files of worlds to drive through, as they are published."""

from pathlib import Path

import numpy as np
import pytest
from bench.planner.fields import FIELD_CELLS, GOAL_M, load_worlds

MODEL = """
    <model name='unit_cylinder_{k}'>
      <static>1</static>
      <pose frame=''>{x:.6f} {y:.6f} 0.000000 0.000000 0.000000 0.000000</pose>
      <link name='link'>
        <inertial><mass>1</mass></inertial>
        <collision name='collision'>
          <geometry>
            <cylinder>
              <radius>0.075000</radius>
              <length>1</length>
            </cylinder>
          </geometry>
        </collision>
        <visual name='visual'>
          <geometry>
            <cylinder>
              <radius>0.075000</radius>
              <length>1</length>
            </cylinder>
          </geometry>
        </visual>
      </link>
    </model>"""
STATE = """
      <model name='unit_cylinder_{k}'>
        <pose frame=''>{x:.6f} {y:.6f} 0.000000 0.000000 0.000000 0.000000</pose>
        <scale>1 1 1</scale>
        <link name='link'>
          <pose frame=''>{x:.6f} {y:.6f} 0.000000 0.000000 0.000000 0.000000</pose>
          <velocity>0 0 0 0 -0 0</velocity>
        </link>
      </model>"""
FLOOR = """
    <model name='ground_plane'>
      <static>1</static>
      <link name='link'>
        <collision name='collision'>
          <geometry><plane><normal>0 0 1</normal><size>100 100</size></plane></geometry>
        </collision>
      </link>
    </model>"""


def sdf(models: list[tuple[float, float]], moved: dict[int, tuple[float, float]] | None = None):
    """A world in the layout of the published ones."""
    bodies = "".join(MODEL.format(k=k, x=x, y=y) for k, (x, y) in enumerate(models))
    now = dict(enumerate(models)) | (moved or {})
    states = "".join(STATE.format(k=k, x=x, y=y) for k, (x, y) in now.items())
    return (
        f"<sdf version='1.6'>\n  <world name='default'>{FLOOR}{bodies}\n"
        f"<state world_name='default'>\n      <sim_time>00 000000000</sim_time>{states}\n"
        "    </state>\n  </world>\n</sdf>\n"
    )


def test_a_published_world_is_seen_from_its_start(tmp_path: Path) -> None:
    # The corners of the pen's back and of the field's end, and one right in front of the robot.
    places = [(-0.075, 0.075), (-4.425, 0.075), (-0.075, 9.525), (-4.425, 9.525), (-2.25, 6.0)]
    (tmp_path / "world_7.world").write_text(sdf(places))
    (world,) = load_worlds(tmp_path)
    expected = [(-2.925, -2.175), (-2.925, 2.175), (6.525, -2.175), (6.525, 2.175), (3.0, 0.0)]
    np.testing.assert_allclose(world.circles[:, :2], expected, atol=1e-9)
    np.testing.assert_array_equal(world.circles[:, 2], 0.075)


def test_where_a_model_stands_now_counts(tmp_path: Path) -> None:
    (tmp_path / "world_0.world").write_text(sdf([(0.0, 5.0), (-1.0, 5.0)], {1: (-2.25, 4.0)}))
    (world,) = load_worlds(tmp_path)
    np.testing.assert_allclose(world.circles[:, :2], [(2.0, -2.25), (1.0, 0.0)], atol=1e-9)


def test_the_published_path_gives_the_length(tmp_path: Path) -> None:
    worlds, paths = tmp_path / "world_files", tmp_path / "path_files"
    worlds.mkdir()
    paths.mkdir()
    for k in (2, 10):
        (worlds / f"world_{k}.world").write_text(sdf([(0.0, 5.0)]))
    # Straight ahead: x of cell 15.5 is that of the start.
    np.save(paths / "path_2.npy", np.array([(15.5, 0.0), (15.5, 29.0)]))
    two, ten = load_worlds(tmp_path)
    assert (two.name, ten.name) == ("world_2", "world_10")
    assert two.published_m == pytest.approx(GOAL_M)
    assert ten.published_m is None
    np.save(paths / "path_2.npy", np.zeros(5))
    with pytest.raises(ValueError, match=r"path_2\.npy: expected a path"):
        list(load_worlds(tmp_path))


def test_a_published_grid_is_the_field_of_its_world(tmp_path: Path) -> None:
    cells = np.zeros((FIELD_CELLS, FIELD_CELLS), int)
    cells[0] = cells[-1] = 1
    cells[4, 20] = 1
    np.save(tmp_path / "grid_3.npy", cells)
    np.save(tmp_path / "path_3.npy", np.array([(15.5, 0.0), (15.5, 29.0)]))
    np.save(tmp_path / "cspace_3.npy", cells)
    (world,) = load_worlds(tmp_path)
    assert world.published_m == pytest.approx(GOAL_M)
    inside = world.circles[np.abs(world.circles[:, 1]) < 2.1]
    inside = inside[inside[:, 0] > -2.0]
    # Row 4 stands at x = -4.425 + 0.6, column 20 at y = 5.075 + 3, as in the world's file.
    (tmp_path / "world").mkdir()
    (tmp_path / "world" / "world_3.world").write_text(sdf([(-3.825, 8.075)]))
    (same,) = load_worlds(tmp_path / "world")
    np.testing.assert_allclose(inside[:, :2], same.circles[:, :2], atol=0.08)


@pytest.mark.parametrize(
    ("name", "text", "why"),
    [
        ("a.world", "<sdf><world>", "a.world: is not an SDF"),
        ("a.world", "<sdf></sdf>", "a.world: holds no <world>"),
        ("a.world", f"<sdf><world>{FLOOR}</world></sdf>", "a.world: no models"),
        ("a.world", sdf([(1.0, 2.0)]).replace("cylinder>", "box>"), "'unit_cylinder_0': only"),
        ("a.world", sdf([(1.0, 2.0)]).replace("1.000000 2", "x 2"), "'unit_cylinder_0': 'x 2"),
        ("a.world", sdf([(1.0, 2.0)]).replace("0.075000", ""), "pose or its radius"),
        ("a.txt", "1 2\n3\n", "a.txt: holds no table"),
        ("a.txt", "1 2 3 4\n", r"a.txt: expected cylinders .*\(1, 4\)"),
        ("a.npy", "nothing", "a.npy: holds no table"),
        ("path_1.npy", "", r"no \*.world"),
    ],
)
def test_a_broken_file_is_refused_by_name(tmp_path: Path, name, text, why) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=why):
        list(load_worlds(tmp_path))


def test_a_grid_of_another_size_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "grid_0.npy", np.full((30, 40), 1))
    with pytest.raises(ValueError, match=r"grid_0\.npy: expected 30 x 30 .*\(30, 40\)"):
        list(load_worlds(tmp_path))


def test_tables_of_cylinders_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("1 2\n3 4\n")
    np.save(tmp_path / "b.npy", np.array([(1.0, 2.0, 0.3)]))
    text, table = load_worlds(tmp_path)
    np.testing.assert_array_equal(text.circles, [(1.0, 2.0, 0.075), (3.0, 4.0, 0.075)])
    np.testing.assert_array_equal(table.circles, [(1.0, 2.0, 0.3)])
