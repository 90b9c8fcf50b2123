from setuptools import find_packages, setup

setup(
    name="slot_core",
    version="0.1.0",
    packages=find_packages(),
    package_data={
        "slot_core": [
            "defaults/**/*.yaml",
            "defaults/**/*.csv",
        ]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/slot_core"]),
        ("share/slot_core", ["package.xml"]),
    ],
    zip_safe=False,
    maintainer="SLOT maintainers",
    maintainer_email="slot@example.com",
    description="Algorithms of the SLOT soft quadruped without ROS.",
    license="Apache-2.0",
)
