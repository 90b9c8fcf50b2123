from setuptools import find_packages, setup

setup(
    name="slot_paper",
    version="0.1.0",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/slot_paper"]),
        ("share/slot_paper", ["package.xml"]),
    ],
    zip_safe=False,
    maintainer="SLOT maintainers",
    maintainer_email="slot@example.com",
    description="The paper of the SLOT soft quadruped as printed: model, controller, claims.",
    license="Apache-2.0",
)
