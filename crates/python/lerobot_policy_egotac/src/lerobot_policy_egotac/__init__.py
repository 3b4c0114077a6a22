"""Touch from sight in LeRobot: importing the package registers the processor step `egotac_touch_processor`.

LeRobot's programs import it by its name, wherever it is installed. In a robot loop of one's own:

    observation_processor = RobotProcessorPipeline(
        steps=[EgotacTouchProcessorStep(camera="head")],
        to_transition=observation_to_transition, to_output=transition_to_observation,
    )
"""

from .touch import EgotacTouchProcessorStep

__all__ = ["EgotacTouchProcessorStep"]
