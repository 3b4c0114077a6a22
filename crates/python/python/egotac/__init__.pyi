"""Types of the package; T = frames, H = height, W = width."""

from os import PathLike
from typing import Any, Iterator, Literal

import numpy as np
from numpy.typing import NDArray

_Path = str | PathLike[str]
_Floats = NDArray[np.float32]
_Unknown = Literal["nan", "zero", "guess"]
_Side = Literal["left", "right"]

__version__: str
#: Names of the 17 regions of a hand, by their index.
REGIONS: list[str]
#: Vertices of a hand, 778.
N_VERTICES: int
#: Probability above which a vertex is in contact.
CONTACT_THRESHOLD: float

class Error(ValueError): ...

class Predictor:
    def __init__(
        self,
        checkpoint: _Path | None = None,
        *,
        precision: Literal["f32", "bf16", "int8"] = "f32",
        unknown: _Unknown = "nan",
        familiarity_threshold: float | None = None,
        presence_threshold: float | None = None,
        max_gap: float | None = None,
        reuse_below: float = 0.0,
        locator: _Path | None = None,
    ) -> None: ...
    def push(
        self, image: NDArray[np.uint8], stamp: float, *, keypoints: NDArray[np.float64] | None = None
    ) -> Touch: ...
    def predict(self, images: NDArray[np.uint8], stamps: NDArray[np.float64]) -> TouchBatch: ...
    def reset(self) -> None: ...
    @property
    def name(self) -> str: ...
    @property
    def sha256(self) -> str: ...
    @property
    def topology(self) -> str: ...
    @property
    def frame_dt(self) -> float: ...
    @property
    def warning(self) -> str | None: ...

class Touch:
    stamp: float
    force: _Floats
    contact: _Floats
    mask: NDArray[np.bool_]
    familiarity: float
    presence: tuple[float, float]
    keypoints: _Floats
    warming_up: bool
    restarted: bool
    reused: bool
    total_force: tuple[float, float]
    region_force: _Floats
    reason: str
    seconds: float
    def policy_input(self, columns: list[str] = ["region_force"]) -> _Floats: ...

class TouchBatch:
    stamps: NDArray[np.float64]
    force: _Floats
    contact: _Floats
    mask: NDArray[np.bool_]
    familiarity: _Floats
    presence: _Floats
    warming_up: NDArray[np.bool_]
    region_force: _Floats

class Hand:
    def __init__(self, side: _Side = "right", *, mano: _Path | None = None, fix_left_shapedirs: bool = False) -> None: ...
    def forward(
        self,
        *,
        hand_pose: _Floats | None = None,
        global_orient: _Floats | None = None,
        betas: _Floats | None = None,
        transl: _Floats | None = None,
    ) -> PosedHand: ...
    def colours(self, force: _Floats, max: float = 1.0) -> NDArray[np.uint8]: ...
    @property
    def region_colours(self) -> NDArray[np.uint8]: ...
    @property
    def regions(self) -> NDArray[np.uint8]: ...
    @property
    def faces(self) -> NDArray[np.uint32]: ...
    @property
    def v_template(self) -> _Floats: ...
    @property
    def side(self) -> _Side: ...
    @property
    def topology(self) -> str: ...

class PosedHand:
    vertices: _Floats
    joints: _Floats
    rotations: _Floats
    keypoints: _Floats

class Labels:
    def __init__(
        self,
        force: _Floats,
        contact: _Floats | None = None,
        *,
        timestamps: NDArray[np.float64] | None = None,
        episode_ends: list[int] | None = None,
        mask_force: NDArray[np.bool_] | None = None,
        mask_contact: NDArray[np.bool_] | None = None,
        topology: str = "egotac-hand-1",
    ) -> None: ...
    def __len__(self) -> int: ...
    @property
    def force(self) -> _Floats: ...
    @property
    def contact(self) -> _Floats: ...
    @property
    def mask_force(self) -> NDArray[np.bool_]: ...
    @property
    def mask_contact(self) -> NDArray[np.bool_]: ...
    @property
    def timestamps(self) -> NDArray[np.float64]: ...
    @property
    def episodes(self) -> list[tuple[int, int]]: ...
    @property
    def topology(self) -> str | None: ...
    @property
    def truth(self) -> Labels | None: ...

class Retargeter:
    def __init__(self, robot: str = "four_finger", *, model: _Path | None = None, side: _Side | None = None) -> None: ...
    def push(
        self,
        keypoints: NDArray[np.float64],
        time: float,
        *,
        force: _Floats | None = None,
        contact: _Floats | None = None,
    ) -> RobotPose: ...
    def reset(self) -> None: ...
    @property
    def joint_names(self) -> list[str]: ...
    @property
    def command_names(self) -> list[str]: ...
    @property
    def side(self) -> _Side: ...

class RobotPose:
    qpos: NDArray[np.float64]
    ctrl: NDArray[np.float64]
    status: str
    objective: float
    solve_time: float
    link_names: list[str]
    link_force: NDArray[np.float64]

class Scene:
    def __init__(self, name_or_path: str) -> None: ...
    @staticmethod
    def names() -> list[str]: ...
    @property
    def name(self) -> str: ...
    @property
    def rate(self) -> float: ...

class Rollout(Iterator[SimFrame]):
    def __init__(self, scene: Scene, seed: int = 0, *, size: tuple[int, int] | None = (224, 224)) -> None: ...
    def __iter__(self) -> Rollout: ...
    def __next__(self) -> SimFrame: ...
    def __len__(self) -> int: ...

class SimFrame:
    stamp: float
    image: NDArray[np.uint8]
    force: _Floats
    contact: _Floats
    validity: str
    left_hand_pose: _Floats | None
    right_hand_pose: _Floats | None

def label(
    input: _Path,
    out: _Path,
    *,
    checkpoint: _Path | None = None,
    unknown: _Unknown = "nan",
    **options: Any,
) -> dict[str, Any]: ...
def metrics(predicted: Labels, truth: Labels, *, fps: float | None = None) -> dict[str, Any]: ...
def policy_input_names(columns: list[str] = ["region_force"]) -> list[str]: ...
def read(path: _Path) -> Labels: ...
def write(path: _Path, labels: Labels, images: NDArray[np.uint8] | None = None) -> None: ...
