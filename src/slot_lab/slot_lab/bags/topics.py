"""Topics of a bag: sensors, outputs of the stages, ground truth."""

ODOMETRY, IMU, MEASURED = "/odom", "/imu", "/joint_states"
SENSORS = (ODOMETRY, IMU, MEASURED)  # in the order of StageRecord's numbers
GROUND_TRUTH = "/ground_truth/odom"
IMAGES = "/camera/image_raw"
LEG_STATES = "/ground_truth/legs"
ESTIMATE, PREVIEWS, PLANS = "/mpc_state", "/gait_preview", "/tendon_plan"
COMMANDED = "/desired_joint_angles"
# the first that is recorded is taken
MOTION_TOPICS = (GROUND_TRUTH, ODOMETRY, ESTIMATE)
OUTPUTS = {
    ESTIMATE: "state_estimator",
    PREVIEWS: "gait_scheduler",
    PLANS: "mpc_controller",
    COMMANDED: "force_mapper",
}
"""Outputs of the stages, in the order of the graph, and our nodes."""
