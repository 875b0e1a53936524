"""Rows of the drivers' work buffer: element ``row * lanes + lane`` of the flat buffer belongs to a lane."""

from sysid.integrate.tableau import STAGES

START = 0  # coordinates 7, rates 7
END = 14  # the same at the step's end
RATES = 28  # accelerations at the stages, 7 rows each; the last stage is the step's end
COEFFICIENTS = RATES + 7 * (STAGES + 1)  # 22, see `sysid.gear.kernel.dynamics.accelerations`
LENGTH = COEFFICIENTS + 10  # leg at rest [m]
REST = COEFFICIENTS + 11  # its angle from the body [rad]
GROUND = COEFFICIENTS + 22  # k_s, b_s
LAW = GROUND + 2  # what the friction law reads, 6
TIME = LAW + 6  # time since the drop's start
STEP = TIME + 1  # step
NEW_STEP = TIME + 2
TAKEN = TIME + 3  # 1 if the step is accepted
NEXT = TIME + 4  # time of the lane's next sample
FRESH = TIME + 5  # 1 before a new job's first accelerations (a step of length 0), 2 in an idle lane
COUNT = TIME + 6  # right-hand sides spent
LIMIT = TIME + 7  # right-hand sides that the job may spend
STIFF = TIME + 8  # inverse of the longest stable step, judged at the step's end [1/s]
# Contact at the step's end, two rows each: rear, front.
NORMAL = TIME + 9
SLIP = TIME + 11
FRICTION = TIME + 13
REQUIRED = TIME + 15
FRICTION_0 = TIME + 17  # friction at the step's start
# Modes of a law that has them, two rows each.
STUCK = TIME + 19
WAY = TIME + 21
MARGIN = TIME + 23
SWITCH = TIME + 25  # at the step's end a foot loses its mode: slipping (1), sticking (2)
# Thrust: cubics of (time - origin) in the current segment.
LIFT = TIME + 27  # 4 coefficients [m/s², ...]
TILT = TIME + 31  # 4 coefficients [rad/s², ...]
ORIGIN = TIME + 35  # lane time at which the segment's own clock is 0
SEGMENT_END = TIME + 36  # lane time at which the segment ends
# What has happened.
TOUCHED = TIME + 37  # two rows: foot touches (one lane) or has touched (several lanes)
FLIPPED = TIME + 39  # 1 once the body has turned over
RESTED = TIME + 40  # 1 once it has come to rest
MOVED = TIME + 41  # end of the last step at whose end the body still moved
HOLD = TIME + 42  # lane time until which the body counts as moving
# Of a law with modes, at the stages within the step, 6 rows each: normal force, slip, required friction, of
# the rear and the front foot.
INNER = TIME + 43
ROWS = INNER + 6 * (STAGES - 1)

# Columns of the thrust segments that a driver reads: start and end on the history's own clock [s], then the
# coefficients of rear and front thrust [N, N/s, ...].
SEGMENT_COLUMNS = 10
# Columns of `plans`: first segment (it holds until the history begins), one past the last, start of the
# history [s], 1 if that start counts from the first contact instead of from the drop's start, and when on
# the history's clock a drop may begin to count as at rest [s], negative: at any time.
PLAN_COLUMNS = 5
