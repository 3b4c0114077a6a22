"""Processor step: touch on both hands, from the images of one camera of the observation."""

import time
from dataclasses import dataclass, field
from typing import Any

import egotac
import numpy as np
import torch
from lerobot.configs.types import FeatureType, PipelineFeatureType, PolicyFeature
from lerobot.processor.pipeline import ObservationProcessorStep, ProcessorStepRegistry

STATE, ENVIRONMENT_STATE = "observation.state", "observation.environment_state"
ROLES = ("names", "state", "environment_state")


@dataclass
@ProcessorStepRegistry.register("egotac_touch_processor")
class EgotacTouchProcessorStep(ObservationProcessorStep):
    """Adds what `egotac label --as ROLE --columns COLUMNS` writes, from live images.

    Attributes:
        camera: key of the images: (H, W, 3) uint8 RGB as a robot gives them, or a tensor (3, H, W) or (1, 3, H, W) of 0 to 1.
        columns: of "region_force" (34, N), "force" (1556, N), "contact" (1556) and "total" (2, N).
        role: "names" adds a number under the name of each element, as robots give joints, from which LeRobot builds the
            features of a data set; "state" appends the vector to `observation.state`; "environment_state" adds it as
            `observation.environment_state`.
        fps: stamps are frame / fps, as in data sets; None = the clock's time.
        checkpoint: file of the network; None = the one that comes with egotac.
        unknown: "nan" (0 in the vector, and the hand is not known), or "guess".
    """

    camera: str = "head"
    columns: list[str] = field(default_factory=lambda: ["region_force"])
    role: str = "names"
    fps: float | None = None
    checkpoint: str | None = None
    unknown: str = "nan"

    def __post_init__(self):
        if self.role not in ROLES:
            raise ValueError(f"role: expected one of {', '.join(ROLES)}, got {self.role!r}")
        self._predictor = egotac.Predictor(self.checkpoint, unknown=self.unknown)
        self._names = egotac.policy_input_names(self.columns)
        self._frame = 0

    def reset(self) -> None:
        """Starts a new episode."""
        self._predictor.reset()
        self._frame = 0

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        if self.camera not in observation:
            raise KeyError(f"camera {self.camera!r} is not in the observation; there: {', '.join(map(str, observation))}")
        image = observation[self.camera]
        stamp = time.monotonic() if self.fps is None else float(np.float32(self._frame / self.fps))
        self._frame += 1
        vector = self._predictor.push(pixels(image), stamp).policy_input(self.columns)
        if self.role == "names":
            return {**observation, **{name: float(value) for name, value in zip(self._names, vector)}}
        if self.role == "environment_state":
            return {**observation, ENVIRONMENT_STATE: like(image, vector)}
        state = observation[STATE]
        if isinstance(state, torch.Tensor):
            more = torch.from_numpy(vector).to(state).expand(*state.shape[:-1], -1)
            return {**observation, STATE: torch.cat([state, more], dim=-1)}
        return {**observation, STATE: np.concatenate([np.asarray(state, np.float32), vector])}

    def get_config(self) -> dict[str, Any]:
        names = ("camera", "columns", "role", "fps", "checkpoint", "unknown")
        return {name: getattr(self, name) for name in names}

    def transform_features(
        self, features: dict[PipelineFeatureType, dict[str, PolicyFeature]]
    ) -> dict[PipelineFeatureType, dict[str, PolicyFeature]]:
        observation = dict(features.get(PipelineFeatureType.OBSERVATION, {}))
        if self.role == "names":
            observation |= {name: float for name in self._names}
        elif self.role == "environment_state":
            observation[ENVIRONMENT_STATE] = PolicyFeature(FeatureType.ENV, (len(self._names),))
        else:
            (width,) = observation[STATE].shape
            observation[STATE] = PolicyFeature(FeatureType.STATE, (width + len(self._names),))
        return {**features, PipelineFeatureType.OBSERVATION: observation}


def pixels(image):
    """Returns an image as (H, W, 3) uint8."""
    if not isinstance(image, torch.Tensor):
        return np.asarray(image)
    image = image[0] if image.ndim == 4 and len(image) == 1 else image
    if image.ndim != 3 or image.shape[0] != 3:
        raise ValueError(f"image: expected a tensor (3, H, W) or (1, 3, H, W), got {tuple(image.shape)}")
    if image.is_floating_point():
        image = (image * 255).round().clamp(0, 255).to(torch.uint8)
    return image.permute(1, 2, 0).contiguous().cpu().numpy()


def like(image, vector):
    """Returns a vector in the form of the observation's images: array, or tensor with or without the axis of a batch."""
    if not isinstance(image, torch.Tensor):
        return vector
    tensor = torch.from_numpy(vector).to(image.device)
    return tensor[None] if image.ndim == 4 else tensor
