from glob import glob

from setuptools import find_packages, setup

FOLDERS = ("dds", "foxglove", "launch", "nav2", "rviz", "udev", "urdf")

setup(
    name="slot_bringup",
    version="0.1.0",
    packages=find_packages(),
    package_data={"slot_bringup": ["graph.yaml"]},
    data_files=[
        (
            "share/ament_index/resource_index/packages",
            ["resource/slot_bringup"],
        ),
        ("share/slot_bringup", ["package.xml"]),
        *((f"share/slot_bringup/{d}", glob(f"{d}/*")) for d in FOLDERS),
    ],
    entry_points={"console_scripts": ["run = slot_bringup.run:main"]},
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="SLOT maintainers",
    maintainer_email="slot@example.com",
    description="Node graph, launch file, runner and operator's terminal of the SLOT robot.",
    license="Apache-2.0",
)
