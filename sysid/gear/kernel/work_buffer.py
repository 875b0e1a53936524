"""Rows of the drivers' work buffer: element ``row * lanes + lane`` of the flat buffer belongs to a lane."""

from sysid.gear.kernel import parameter_row
from sysid.gear.kernel.dynamics import Coefficients
from sysid.gear.kernel.parameter_row import LAW_SLOTS
from sysid.integrate.tableau import STAGES

# Coordinates of the state, in the frame of the slope; their rates follow in the same order.
S, W, PHI, H_C, THETA_C, H_D, THETA_D = range(7)
COORDINATES = 7

ROWS = 0


def _rows(count: int = 1) -> int:
    """Reserve the next rows and return the first of them."""
    global ROWS
    first, ROWS = ROWS, ROWS + count
    return first


START = _rows(2 * COORDINATES)  # coordinates, then rates
END = _rows(2 * COORDINATES)  # the same at the step's end
RATES = _rows(COORDINATES * (STAGES + 1))  # accelerations at the stages; the last stage is the step's end
COEFFICIENTS = _rows(len(Coefficients._fields))  # in the order of their fields
LENGTH = COEFFICIENTS + Coefficients._fields.index("length")  # leg at rest [m]
PER_M, PER_I = (COEFFICIENTS + Coefficients._fields.index(name) for name in ("per_m", "per_i"))
GROUND_SPRING = _rows()  # k_s
GROUND_DAMPER = _rows()  # b_s
# Numbers that the friction law reads. A law with modes reads mu_k, mu_s - mu_k, the front foot's excess.
LAW = _rows(LAW_SLOTS)
SLOPE = _rows()  # angle of the surface [rad]
COS_SLOPE = _rows()
SIN_SLOPE = _rows()
TERM_VALUES = _rows(parameter_row.TERMS)  # what `sysid.gear.kernel.terms` reads
TIME = _rows()  # since the drop's start
STEP = _rows()
NEW_STEP = _rows()
TAKEN = _rows()  # 1 if the step is accepted
NEXT = _rows()  # time of the lane's next sample
DUE = _rows()  # 0 or more where the step needs more than to be taken: a sample, an event, an end
FRESH = _rows()  # 1 before a new job's first accelerations (a step of length 0), 2 in an idle lane
COUNT = _rows()  # right-hand sides spent
LIMIT = _rows()  # right-hand sides that the job may spend
STIFF = _rows()  # inverse of the longest stable step, judged at the step's end [1/s]
# Contact at the step's end, two rows each: rear, front.
NORMAL = _rows(2)
SLIP = _rows(2)
REQUIRED = _rows(2)
FRICTION = _rows(2)
FRICTION_0 = _rows(2)  # friction at the step's start
# Modes of the feet under a law with modes, two rows each.
STUCK = _rows(2)
WAY = _rows(2)
MARGIN = _rows(2)
SWITCH = _rows(2)  # at the step's end a foot loses its mode: slipping (1), sticking (2)
# Thrust: cubics of (time - origin) in the current segment, four coefficients each.
LIFT = _rows(4)  # [m/s², ...]
TILT = _rows(4)  # [rad/s², ...]
ORIGIN = _rows()  # lane time at which the clock of the segment is 0
SEGMENT_END = _rows()  # lane time at which the segment ends
# Events so far.
TOUCHED = _rows(2)  # foot touches (with a log of events) or has touched (without)
FLIPPED = _rows()  # 1 once the body has turned over
RESTED = _rows()  # 1 once it has come to rest
MOVED = _rows()  # end of the last step at whose end the body still moved
HOLD = _rows()  # lane time until which the body counts as moving
# The contact of a law with modes at every stage within the step, as from `NORMAL` on.
INNER_ROWS = 6
INNER = _rows(INNER_ROWS * (STAGES - 1))
INNER_NORMAL, INNER_SLIP, INNER_REQUIRED = 0, 2, 4

# Columns of the thrust segments: start and end on the history's clock [s], then four coefficients each of the
# rear and the front thrust [N, N/s, ...].
SEGMENT_COLUMNS = 10
SEGMENT_FROM, SEGMENT_TO, SEGMENT_REAR, SEGMENT_FRONT = 0, 1, 2, 6
# Columns of a drop's plan: its first segment (used until the history begins), one past its last segment, the
# start of the history [s], 1 if that start counts from the first contact instead of from the drop's start,
# and the time on the history's clock from which on a drop may count as at rest [s], negative: any time.
PLAN_COLUMNS = 5
PLAN_FIRST, PLAN_STOP, PLAN_START, PLAN_WAITS, PLAN_SETTLED = range(5)
