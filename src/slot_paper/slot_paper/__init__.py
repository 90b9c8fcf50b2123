"""The paper as printed, to be held beside it: one module for each of its parts.

S. Karan, N. Maram, S. Borate, M. Vadali, "Dynamic Modeling and MPC for Locomotion of Tendon-Driven
Soft Quadruped". In all modules P is the paper and S the scripts that its authors published; S
supplies what P leaves open, and where S contradicts P, P is used.

    leg            III     a leg of 31 nodes in its plane
    robot          IV      four such legs that move a rigid torso; level `paper` of a scene
    problem        V-B     MPC on ground reaction forces; policies `paper_text`, `paper_code`
    gaits          V-A     front legs in turns, and where the gaits of the experiments stand
    force_map      V-D     tendon angles on a line over the normal forces
    perturbations  V-E     seven perturbations of the published problem, Table IV
    tables         V, VI   the figures of tables and text, and where ours are found
    claims         all     every quantitative claim with a verdict and its reason

Numbers are in `config/paper.yaml` and `config/mpc/paper_*.yaml`, geometry and masses in
`config/robot.yaml`.
"""
