from setuptools import find_packages, setup

setup(
    name="slot_lab",
    version="0.1.0",
    packages=find_packages(),
    package_data={
        "slot_lab.report.run_page": ["*.html", "*.css", "*.js", "three/*"]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/slot_lab"]),
        ("share/slot_lab", ["package.xml"]),
    ],
    zip_safe=False,
    maintainer="SLOT maintainers",
    maintainer_email="slot@example.com",
    description="Work at the desk with the SLOT soft quadruped: bags, reports, identification.",
    license="Apache-2.0",
)
