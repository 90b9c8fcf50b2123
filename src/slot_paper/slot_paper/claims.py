"""The paper's quantitative claims one by one: which hold, which do not, and why.

    reproduced         ours agrees, or it follows from the paper's own numbers
    corrected          it holds with another number or under another condition, which is named
    refuted            it contradicts the paper's own numbers, its published code, or ours
    not addressable    what it rests on is not published, or needs the real robot

Figures of ours are those of the pages of the documentation; the tables beside this one are
`tables`. A test repeats the arithmetic.
"""

from dataclasses import dataclass

REPRODUCED, CORRECTED, REFUTED, OPEN = (
    "reproduced",
    "corrected",
    "refuted",
    "not addressable",
)
VERDICTS = (REPRODUCED, CORRECTED, REFUTED, OPEN)


@dataclass(frozen=True)
class Claim:
    """A claim, its place in the paper, and our verdict with its reason."""

    place: str
    text: str
    verdict: str
    reason: str


CLAIMS = (
    # model of the leg
    Claim(
        "III-A",
        "out-of-plane bending and twist are negligible for the gaits",
        REFUTED,
        "with legs that bend in their planes only the walk is slower: 0.041 instead of "
        "0.069 m/s at friction 0.4, and other strides are best",
    ),
    Claim(
        "III-A, Table I",
        "E = 10 MPa, explicit Euler at 0.1 ms is numerically stable",
        REFUTED,
        "the published scheme, semi-implicit Euler, diverges within 1 ms at the "
        "printed numbers; explicit Euler is less stable",
    ),
    Claim(
        "III-A",
        "31 nodes are a trade-off of accuracy and real-time cost",
        CORRECTED,
        "a chain of fourth order has an error of 0.25 % with 7 nodes and 0.24 % with 31, at 4 "
        "times the cost",
    ),
    Claim(
        "III-C",
        "E is refined by deflection tests to 10 MPa",
        CORRECTED,
        "26 MPa fit the six figures of the single-leg test better (sum of squares 14 instead of "
        "373 on two degrees of freedom), and do not explain them either",
    ),
    Claim(
        "III-C",
        "restoring springs of 800 N/m a node do not dominate the elastic response",
        REFUTED,
        "they carry the leg: bending stiffness has no influence on any position, since "
        "the moments turn the nodes and do not move them",
    ),
    Claim(
        "III-D",
        "I_i = rho A_i dx^2 / 2 is the moment of inertia of a segment",
        REFUTED,
        "its unit is kg m",
    ),
    Claim(
        "III-B, Table I",
        "friction 0.1; 0.6, 0.2 and 0.1 by phase in the MPC",
        CORRECTED,
        "the walk needs the friction by phase: as published it makes -7 mm/s on an equal 0.4",
    ),
    Claim(
        "Table I",
        "T_max = 1.5 N m; servos of 1.4 N m (II)",
        REFUTED,
        "two figures for one servo, and a tension in N m; the maker says 1.4 N m at 11.1 V",
    ),
    # whole body
    Claim(
        "IV-B",
        "the legs do not matter for the torso's inertia",
        CORRECTED,
        "with them the moments of inertia are 2.2, 1.8 and 2.0 times those of the torso",
    ),
    Claim(
        "IV-B",
        "the gyroscopic term is small",
        REPRODUCED,
        "1.7 % of the change of angular momentum, RMS, in our walk and in our crawl",
    ),
    Claim(
        "IV-B, Table III",
        "the walk's centre of mass within 4.0 mm in x, 4.8 mm in z",
        OPEN,
        "neither measurement nor alignment is published",
    ),
    Claim(
        "IV-B, Table III",
        "the crawl's centre of mass within 5.1 mm in x, 4.6 mm in z",
        OPEN,
        "the same; ours crawls at 25 mm/s, but there is no measurement to compare it with",
    ),
    Claim(
        "abstract",
        "less than 5 mm of RMSE in the centre of mass",
        REFUTED,
        "5.1 mm in Table III; the conclusion says 4 to 5 mm",
    ),
    # single leg
    Claim(
        "VI-B, Table II",
        "RMSE 0.89 to 5.72 mm, MAE 0.71 to 3.90 mm at four points of a leg",
        OPEN,
        "no measurement is published; ours of a synthetic one stand above",
    ),
    Claim(
        "VI-B, Table II",
        "accuracy above 95 %",
        CORRECTED,
        "our formulas give the table's digits: accuracy counts the mean error alone, so that "
        "an error that oscillates counts as none; by RMSE it is 80.8 to 94.1 %",
    ),
    Claim(
        "VI-A",
        "2 % of depth at 0.6 to 1.0 m is an uncertainty below 2 mm",
        REFUTED,
        "2 % of that are 12 to 20 mm, more than every RMSE of Tables II and III",
    ),
    # MPC
    Claim(
        "V",
        "legs 0.35 ms each, torso 0.18 ms a step: real time",
        REFUTED,
        "1.58 ms of computing for a step of 0.1 ms is 16 times slower than real time",
    ),
    Claim(
        "V",
        "the MPC takes 6.2 ms by CVXPY and SCS on a Jetson Xavier",
        REFUTED,
        "the published code builds the problem anew in every cycle: 217 ms on a faster machine; "
        "compiled once and with another solver 6.4 ms",
    ),
    Claim(
        "V",
        "gait, force map and PID take less than 0.5 ms",
        OPEN,
        "no such machine here; ours stand above, between processes",
    ),
    Claim("V-C", "15 stages of 33 ms are 0.495 s", REPRODUCED, "they are"),
    Claim(
        "V-B",
        "weight of p_z 100 / 1000",
        CORRECTED,
        "the published code has 100000 / 1000; with it the table of perturbations comes out",
    ),
    Claim(
        "V-B",
        "R = 1e-8 balances control authority and smoothness",
        REFUTED,
        "the first forces are nearly not unique (condition 5e7); with 1e-6 the order of two rows "
        "of Table IV turns round",
    ),
    Claim(
        "V-B",
        "f_z at most 6 N",
        CORRECTED,
        "6 N are 120.65 deg on the paper's line, beyond its 116.28 deg: 5.532 N",
    ),
    Claim(
        "V-B",
        "sum f_z = m g, while gaits lift and place legs",
        REFUTED,
        "three legs of 6 N carry 18 of 21.2 N; and with the sum fixed no height is controlled",
    ),
    Claim(
        "V-D",
        "theta = (f_z + 6.91) / 0.107 maps force to angle",
        CORRECTED,
        "at one height only: a standing leg carries m g / 4 at any height, so that the line "
        "makes 114 deg of all of them",
    ),
    Claim(
        "V-D, III-C",
        "the line is of independent experiments; of a series of simulations",
        REFUTED,
        "the paper says both",
    ),
    Claim(
        "V-C",
        "batches of 20 MPC steps; 15 (V-E); no update is skipped",
        REFUTED,
        "three statements that exclude each other; the published walk skips 5 of 25",
    ),
    Claim(
        "VI-E, algorithm",
        "an infeasible cycle repeats the last feasible input",
        CORRECTED,
        "the published code returns zeros; paper_text does as printed",
    ),
    # locomotion
    Claim(
        "VI-E, Fig. 9",
        "0.08 m/s at a height of 0.04 m",
        CORRECTED,
        "one at a time: 0.079 m/s at a mean height of 65 mm, 0.025 m/s at 44 mm",
    ),
    Claim(
        "VI-E, Fig. 9",
        "the MPC on forces does that",
        REFUTED,
        "term by term, as printed or as published, it stands: -12 to 2 mm/s, 77 to 120 mm high",
    ),
    Claim(
        "VI-E",
        "lateral deviation of at most 3.2 cm over 0.8 m",
        OPEN,
        "of their robot on their floor; in simulation on even friction at most 8 mm of 5 seeds, "
        "on friction 0.5 and 0.3 more than theirs",
    ),
    Claim(
        "VI-E",
        "lateral RMSE of 1.4 cm over 0.8 m",
        OPEN,
        "of their robot on their floor; in simulation on even friction at most 3 mm of 5 seeds",
    ),
    Claim(
        "VI-E, Fig. 11",
        "0.052 m/s ahead and 0.09 m/s aside at once",
        CORRECTED,
        "0.104 m/s, more than their 0.08 m/s straight ahead, on a model without legs; ours holds "
        "0.06 m/s in all directions, beyond which the servos are at their limit",
    ),
    Claim(
        "VI-E, Fig. 11",
        "RMSE of 3.5 cm on the path at 60 degrees",
        OPEN,
        "the script of that gait is not published; ours has 5.1 mm at half of its speed",
    ),
    Claim(
        "II",
        "climbs inclines of 20 degrees",
        OPEN,
        "of other gaits on the robot; ours climbs 5 degrees, and slides back on 10",
    ),
    # stability
    Claim(
        "VI-E, Table IV",
        "maximum costs of Baseline, Roll, Height, Velocity, Combined",
        REPRODUCED,
        "within 0.2 %, from a start at zero height and speed and not, as stated, "
        "at the reference, where the cost is zero",
    ),
    Claim(
        "VI-E, Table IV",
        "maximum cost 4.792 of Pitch",
        REFUTED,
        "ill-posed: 4.70 to 5.39 for angles of 0 to 0.3 rad, not monotonic; without the raised "
        "forces of the first three steps all have 2.383",
    ),
    Claim(
        "VI-E, Table IV",
        "mean costs",
        REPRODUCED,
        "within 2 %, but for Pitch and Noise",
    ),
    Claim(
        "VI-E, Table IV",
        "all settle within 14.553 s",
        CORRECTED,
        "7.9 to 14.7 s: the crawl within the band of 0.01 N by which the published code lets the "
        "sum differ from the weight",
    ),
    Claim(
        "VI-E, Table IV",
        "Velocity settles in 10.098 s",
        CORRECTED,
        "7.92 s, 22 % less",
    ),
    Claim(
        "VI-E, Table IV",
        "Noise of 0.001 does not settle",
        OPEN,
        "seed and clipping are not published; with ours it does not settle either",
    ),
    Claim(
        "VI-E",
        "no infeasible step, hence recursive feasibility",
        REFUTED,
        "no step is infeasible; but no limit depends on the state, so that this says nothing",
    ),
    Claim(
        "abstract, VII",
        "asymptotic stability",
        REFUTED,
        "with sum f_z = m g the rows of p_z and v_z of the controllability matrix are zero",
    ),
    Claim(
        "VI-E, Fig. 13",
        "infeasible at 22.374 and 61.875 s at 60 degrees",
        OPEN,
        "the script of that gait is not published; its limits can only be infeasible where a leg "
        "carries nothing",
    ),
)
