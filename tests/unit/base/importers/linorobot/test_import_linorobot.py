"""`trolley import linorobot`."""

from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from trolley.config import load_config
from trolley.gridmap import load_map
from trolley_base.commands.import_linorobot import import_linorobot

from .conftest import Package


@pytest.fixture(autouse=True)
def _no_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("LINOBASE", raising=False)
    monkeypatch.delenv("LINOLIDAR", raising=False)


def run(*arguments: object) -> Result:
    return CliRunner().invoke(import_linorobot, [*map(str, arguments)])


def test_writes_a_robot_toml_that_can_be_used(package: Package, tmp_path: Path) -> None:
    output = tmp_path / "home" / "robot.toml"
    result = run(package.folder, "-o", output, "--base", "mecanum", "--lidar", "rplidar")
    assert result.exit_code == 0, result.output
    config = load_config(output)
    assert config.robot.drive == "mecanum"
    assert config.base.driver == "hardware"
    assert config.base.lidar.model == "rplidar_a1"
    assert config.map.file is not None
    grid = load_map(config.path(config.map.file))
    assert (grid.name, grid.cells.shape) == ("house", (20, 40))
    assert "AMCL ignored" in result.output


def test_overwrites_nothing_unasked(package: Package, tmp_path: Path) -> None:
    output = tmp_path / "robot.toml"
    assert run(package.folder, "-o", output).exit_code == 0
    output.write_text("mine")
    refused = run(package.folder, "-o", output)
    assert refused.exit_code == 2
    assert "already exists; not overwritten" in refused.output
    assert output.read_text() == "mine"
    assert run(package.folder, "-o", output, "--force").exit_code == 0
    assert load_config(output).robot.name == "trolley"


def test_overwrites_no_other_map(package: Package, tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "house.yaml").write_text("another")
    assert run(package.folder, "-o", tmp_path / "robot.toml").exit_code == 2
    assert not (tmp_path / "robot.toml").exists()


def test_brings_an_image_from_elsewhere_beside_the_map(package: Package, tmp_path: Path) -> None:
    image = tmp_path / "elsewhere.pgm"
    package.path("maps/house.pgm").rename(image)
    package.change("maps/house.yaml", "house.pgm", str(image))
    output = tmp_path / "out" / "robot.toml"
    assert run(package.folder, "-o", output).exit_code == 0
    image.unlink()
    assert load_map(tmp_path / "out" / "maps" / "house.yaml").cells.shape == (20, 40)


def test_may_write_into_the_package_itself(package: Package) -> None:
    assert run(package.folder, "-o", package.path("robot.toml")).exit_code == 0
    assert load_map(package.path("maps/house.yaml")).cells.shape == (20, 40)


def test_refuses_a_folder_that_is_no_package(tmp_path: Path) -> None:
    result = run(tmp_path, "-o", tmp_path / "robot.toml")
    assert result.exit_code == 2
    assert "holds no file of a linorobot" in result.output


def test_refuses_a_value_that_no_robot_has(package: Package, tmp_path: Path) -> None:
    package.change("launch/bringup.launch", "57600", "7")
    result = run(package.folder, "-o", tmp_path / "robot.toml", "--base", "2wd")
    assert result.exit_code == 2
    assert "[base.chassis.baud]" in result.output
    assert not (tmp_path / "robot.toml").exists()
    assert not (tmp_path / "maps").exists()
