"""Registry of the policies by name."""

DEFAULT_POLICY = "rollout_mpc"
MPC = "slot_core.mpc.force_mpc:ForceMpc"
POLICIES = {
    DEFAULT_POLICY: "slot_core.rollout_mpc.rollout_mpc:RolloutMpc",  # MPC that simulates the robot
    "place": "slot_core.control.place_feedback:PlaceFeedback",  # amplitudes from the place's error
    "force_mpc": MPC,  # MPC on ground reaction forces
    "paper_text": MPC,  # the same as printed in the paper
    "paper_code": MPC,  # and as in the authors' published scripts
    "gait_alone": "slot_core.control.gait_alone:GaitAlone",
}
"""Module and class by name."""
RENAMED = {"predictive": "rollout_mpc", "forces": "force_mpc"}
"""Present name by an earlier one, as old bags and scripts hold it."""
