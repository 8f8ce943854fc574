"""`[base] driver = "hardware"`: the motor board and the lidar that are plugged in."""

from collections.abc import Callable
from importlib.util import find_spec

from trolley.config import ConfigError, RobotConfig
from trolley.config.hardware import ChassisConfig
from trolley.network_ports import explain_network, is_network, parse_address
from trolley.serial_diagnosis import explain
from trolley_base.drivers import CallSoon, DriverError
from trolley_base.drivers.boards import find_board, make_board
from trolley_base.drivers.device import Opened
from trolley_base.drivers.dialogue import BoardDialogue
from trolley_base.drivers.imus.bus import LinuxBus
from trolley_base.drivers.imus.i2c_imu import I2cImu
from trolley_base.drivers.lidars import make_lidar
from trolley_base.drivers.real_hardware import RealHardware
from trolley_base.persistence import SavedWorld

NO_BOARD = "No motor board is set ([base.chassis] board), so commands have no effect."
LONGEST_DELAY_S = 0.35
"""Where nobody has measured it: a board that looks at its commands ten times a second, motors that
follow a control loop, and the way there and back."""


class RealDevice:
    """The devices of the configuration; whether they are there shows when they are opened."""

    world: str | None = None
    rate = 1.0
    is_stepped = False

    def __init__(self, config: RobotConfig) -> None:
        chassis, lidar = config.base.chassis, config.base.lidar
        if lidar.model is None or not lidar.port:
            raise ConfigError(
                '[base] driver = "hardware" needs [base.lidar] model and port; '
                "`trolley detect` finds them"
            )
        if chassis.board is not None and not chassis.port:
            raise ConfigError("[base.chassis] needs port; `trolley detect` finds it")
        if chassis.board is not None and _same_port(config, chassis.port, lidar.port):
            raise ConfigError(
                f"[base.chassis] and [base.lidar] both name the port {lidar.port}; "
                "`trolley detect` tells which is which"
            )
        self._config = config
        self.base_T_laser = lidar.pose.as_pose()
        self.cannot_drive = NO_BOARD if chassis.board is None else ""
        self.delay_s = LONGEST_DELAY_S if chassis.delay_s is None else chassis.delay_s
        # What is assumed where nobody has measured is too long to predict with.
        usual_s = chassis.usual_delay_s
        self.usual_delay_s = chassis.delay_s if usual_s is None else usual_s
        if config.base.imu is not None and find_spec("smbus2") is None:
            raise ConfigError(
                '[base.imu] needs smbus2, which is not installed: pip install "trolley-robot[i2c]"'
            )
        for port in filter(is_network, (chassis.port, lidar.port)):
            try:
                parse_address(port)
            except ValueError as error:
                raise ConfigError(f"[base] {error}") from error
        try:
            make_lidar(lidar)
            if chassis.board is not None:
                _check_calls(chassis, make_board(chassis, config.robot.drive))
            self.watchdog_s = _watchdog_s(chassis)
        except DriverError as error:
            raise ConfigError(str(error)) from error

    def open(
        self,
        start_ns: int,
        saved: SavedWorld | None,
        robot_ns: Callable[[int], int],
        call_soon: CallSoon,
    ) -> Opened:
        """Begin to open the ports; what is not there yet is tried repeatedly."""
        del saved
        chassis, lidar = self._config.base.chassis, self._config.base.lidar
        board = None
        if chassis.board is not None:
            dialogue = make_board(chassis, self._config.robot.drive)
            board = dialogue, _port(self._config, chassis.port)
        seeing = make_lidar(lidar), _port(self._config, lidar.port)
        imu = self._config.base.imu
        chip = None if imu is None else I2cImu(imu, LinuxBus)
        return Opened(RealHardware(board, seeing, start_ns, robot_ns, call_soon, _explain, chip))


def _watchdog_s(chassis: ChassisConfig) -> float:
    """Return after what silence the board stops [s]: as its owner says, else as it is delivered."""
    if chassis.board is None:
        return 0.0
    return chassis.watchdog_s or find_board(chassis).facts.watchdog_s


def _check_calls(chassis: ChassisConfig, board: BoardDialogue) -> None:
    """Refuse a port that is called for a board that calls."""
    if board.line.datagrams is None or not is_network(chassis.port):
        return
    address = parse_address(chassis.port)
    if address.kind == "udp" and address.host:
        raise DriverError(
            f"[base.chassis] port = {chassis.port!r}: over UDP a {chassis.board} sends to this "
            f'computer, so write port = "udp://:{address.port}"'
        )


def _port(config: RobotConfig, name: str) -> str:
    return name if is_network(name) else str(config.path(name))


def _explain(port: str, error: OSError) -> str:
    return explain_network(port, error) if is_network(port) else explain(port, error)


def _same_port(config: RobotConfig, one: str, other: str) -> bool:
    if is_network(one) or is_network(other):
        return one == other
    return config.path(one).resolve() == config.path(other).resolve()
