"""Registry of the policies by name."""

DEFAULT_POLICY = "predictive"
MPC = "slot_core.mpc.mpc:Mpc"
POLICIES = {
    DEFAULT_POLICY: "slot_core.predictive.predictive:Predictive",  # MPC that simulates the robot
    "place": "slot_core.control.place_feedback:PlaceFeedback",  # amplitudes from the place's error
    "forces": MPC,  # MPC on ground reaction forces
    "paper_text": MPC,  # the same as printed in the paper
    "paper_code": MPC,  # and as in the authors' published scripts
    "gait_alone": "slot_core.control.gait_alone:GaitAlone",
}
"""Module and class by name."""
