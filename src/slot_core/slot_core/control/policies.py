"""Registry of the policies by name.

The paper's are in the package `slot_paper`, which is imported only when one is used.
"""

DEFAULT_POLICY, GAIT_ALONE = "rollout_mpc", "gait_alone"
PAPER = "slot_paper.problem:PaperMpc"
POLICIES = {
    DEFAULT_POLICY: "slot_core.rollout_mpc.rollout_mpc:RolloutMpc",  # MPC that simulates the robot
    "place": "slot_core.control.place_feedback:PlaceFeedback",  # amplitudes from the place's error
    "force_mpc": "slot_core.mpc.force_mpc:ForceMpc",  # MPC on ground reaction forces
    "paper_text": PAPER,  # the same as printed in the paper
    "paper_code": PAPER,  # and as in the authors' published scripts
    GAIT_ALONE: "slot_core.control.policy:GaitAlone",
}
"""Module and class by name."""
RENAMED = {"predictive": "rollout_mpc", "forces": "force_mpc"}
"""Present name by an earlier one, as old bags and scripts hold it."""
