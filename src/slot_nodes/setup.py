from setuptools import find_packages, setup

NODES = (
    "dynamixel_driver",
    "force_mapper",
    "gait_scheduler",
    "marker_localizer",
    "mpc_controller",
    "recorder",
    "sim_robot",
    "state_estimator",
    "supervisor",
    "visualizer",
)

setup(
    name="slot_nodes",
    version="0.1.0",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/slot_nodes"]),
        ("share/slot_nodes", ["package.xml"]),
    ],
    entry_points={
        "console_scripts": [
            *(f"{n} = slot_nodes.process.composed:serve_one" for n in NODES),
            "controller = slot_nodes.process.composed:main",
        ]
    },
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="SLOT maintainers",
    maintainer_email="slot@example.com",
    description="ROS 2 nodes of the SLOT soft quadruped.",
    license="Apache-2.0",
)
