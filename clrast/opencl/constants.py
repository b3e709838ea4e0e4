"""Every number that host and device share: their only home, free of numpy, so that a command line starts without it.

`layout.py` has them too, beside the structs, and `kernels.py` turns both into C.
"""

NO_HIT = 0xFFFFFFFF
"""`prim_id`, `object_id` and `material_id` where nothing is hit."""

MAX_IMAGE_SIDE = 65535
"""Pixels; screen bounds are kept in 16 bits a side."""

WIDE_TILE_COUNT = 12
"""A bound over more tiles than this makes a triangle wide."""

LARGE_BLOCK_COUNT = 24
"""A bound over more blocks of samples than this in one tile is tested block by block before samples are."""

CROSSING_RATIO = 2.0**-10
"""A vertex whose depth is under this share of its 1-norm distance counts as crossing the eye's plane."""

BOUND_SLACK = 16.0 * 2.0**-24
"""Relative widening of a projected screen bound; derived in cl/setup_triangles.cl."""

EDGE_SLACK = 8.0 * 2.0**-24
"""Forward error of an edge function, relative to the sum of its terms' magnitudes, where a bound is clipped."""

CONTENDER_COUNT = 0
"""Words of a contender list's state: how many contenders there are,"""

CONTENDER_FACINGS = 1
"""how many triangles show float32 no side,"""

CONTENDER_FLOAT64 = 2
"""how many contenders float64 settled,"""

CONTENDER_EXACT = 3
"""and how many exact arithmetic."""

CONTENDER_WORDS = 4

CHUNK_COUNT = 32
"""Runs of triangles that one work-item each counts and scatters; changes nothing but balance."""

PROJECTION_PERSPECTIVE = 0
PROJECTION_ORTHOGRAPHIC = 1
PROJECTION_PARABOLOID = 2
PROJECTION_LATLONG = 3
PROJECTION_FISHEYE = 4

PRECISION_FAST = 0
PRECISION_ORDERED = 1
PRECISION_MIDPOINT = 2
PRECISION_DOUBLE = 3
PRECISION_FIXED = 4
PRECISION_EXACT = 5

SUBPIXEL_LOG2 = 12
SUBPIXELS = 1 << SUBPIXEL_LOG2
"""Of a pixel's side: what --precision fixed snaps projected vertices to."""

EDGES_3D = 0
EDGES_2D = 1
EDGES_2DH = 2
EDGES_BARYCENTRIC = 3

EVALUATION_DIRECT = 0
EVALUATION_INCREMENTAL = 1

INCREMENT_CELL = 32
"""Samples a side of the squares in which incremental evaluation starts anew; a power of two."""

INCREMENT_SLACK = 64.0 * 2.0**-24
"""Error of an incrementally evaluated edge function relative to its terms: 16 sums, each within 2^-24, and slack."""

INCREMENT_CURVED_SLACK = (36.0 + 1.125 * INCREMENT_CELL) * 2.0**-24
"""The same of a paraboloid's, relative to |n| and the square of how far a square reaches; derived in
cl/incremental_edges.clh."""

IS_OUTSIDE_NEVER = 0
IS_OUTSIDE_SCREEN_BOUND = 1

IS_OCCLUDED_NEVER = 0
IS_OCCLUDED_W_BUFFER = 1

SPLIT_FRUSTUM_NEVER = 0
SPLIT_FRUSTUM_CENTER = 1
SPLIT_FRUSTUM_SMALL = 2
SPLIT_FRUSTUM_ADAPTIVE = 3
SPLIT_FRUSTUM_ALWAYS = 4

GENERATE_SAMPLES_ROOT = 0
GENERATE_SAMPLES_LEAF = 1

BINNING_NEVER = 0
BINNING_BLOCKS = 1

MIN_FRUSTUM_LOG2 = 3
"""Frusta of 8 x 8 samples are not split (Davidovic et al., section 5)."""

NODE_WIDTH = 16
"""Children of a node of the BVH."""

LEAF_BIT = 0x80000000
"""Of a child: it is a leaf, the other bits are its first slot."""

EMPTY_CHILD = 0xFFFFFFFF

MAX_LEAF_COUNT = 16
"""Triangles of a leaf, for rays: their number less 1 stands in the four bits under LEAF_BIT."""

BLOCK_LANES = 8
"""Triangles of a block of a leaf, for rays; a leaf has whole blocks."""

BLOCK_WORDS = 10
"""Words of each triangle in a block: three corners, and one for its prim_id and its turn."""

TURN_LOG2 = 30
"""Of that word: the turn of the corners stands above the prim_id."""

NODE_WORDS = 7 * NODE_WIDTH
"""Words of a node of the BVH, for rays: six of each child's box, and what the child is."""

MAX_LISTED = 64
"""Triangles of a scene through which rays take no structure, but meet each: cl/triangle_list.clh."""

LIST_WORDS = 10
"""Words of each of them."""

LEAF_SLOT_LOG2 = 27
LEAF_SLOT = (1 << LEAF_SLOT_LOG2) - 1
"""Of such a leaf: the bits of its first block."""

WORK_COUNTERS = (
    "setups", "edge_evaluations", "samples_tested", "samples_covered", "samples_written", "traversal_steps",
    "frusta_split", "blocks_culled", "nodes_culled",
)  # fmt: skip
"""Columns of a work item's counters, in the order of `Work` in cl/counters.clh."""

WORK_COUNTER_COUNT = len(WORK_COUNTERS)

LIST_CHUNK = 256
"""Entries that one work item counts and lists where lists are made by prefix sums; a multiple of 16."""

MAX_GRID_SIDE = 1023
"""Cells of a grid along an axis: numbers of cells of three axes fit one word of a ray's state."""

CELL_CHUNK = 4096
"""Cells of a grid whose counts one work item adds up."""

ORDER_CHUNK = 256
"""Cells whose lists one work item puts in order."""

SHORT_LIST = 32
"""Lists up to this long are sorted by insertion."""

RAY_BLOCK = 8
"""A work item of traverse_grid takes a square of this many rays a side, one after the other."""

TRACE_TEST = 0x80000000
"""Of a word that a ray writes down: it is a triangle that was tested, else a cell that was entered;"""

TRACE_IN_BOUND = 0x40000000
"""of such a triangle: its bound holds the sample, so that its nearness was read;"""

TRACE_EVALUATED = 0x20000000
"""and its edge functions were evaluated."""

RAY_TRAVERSING = 0
"""States of a ray in passes: it looks for cells with triangles,"""

RAY_INTERSECTING = 1
"""it is tested against those of a cell,"""

RAY_SHADING = 2
"""it has met all that it had to, or it left the grid,"""

RAY_DONE = 3
"""or never met it."""

RECORD_WORDS = 16
"""32-bit words of a triangle's record: see cl/record_triangles.cl."""

NEARNESS_DOUBT = 2.0**-10
"""What computed w may be off by, relative to itself, where a triangle is left to the grid."""

MAX_SHARED_SAMPLES = 32
"""Most samples of a pixel whose shading is shared."""

SAME_SURFACE_COSINE = 63.0 / 64.0
"""Triangles of a pixel whose normals are within this cosine (10 degrees) may count as one surface."""

FINE_TRIANGLE_PIXELS = 4.0
"""Triangles lower than this have neighbours in a pixel that none of its samples may show."""

SURFACE_OF_CENTER = 0
"""Of a sample: its surface is what the pixel's centre shows."""
SURFACE_UNKNOWN = 254
"""Of a coverage sample: no known triangle covers it."""
SURFACE_NOTHING = 255

HAS_LIGHT_RAY = 1
HAS_OWN_LIGHT = 2
"""Bits of what light an item of a path may bring: shade_paths.cl."""

STRATA = 6
"""Surfaces of a pixel whose samples auto keeps apart, and the crowd of all others: 3 bits say which a sample is of."""

VISIT_SAMPLES = 16
"""Samples of a pixel that are judged together where pixels are listed: 2 vectors of 8 lanes, or one of 16."""

LANE_GROUPS = 4
"""Vectors of samples that listed pixels are decided at while triangles are set up once."""

LIGHT_POINT = 0
LIGHT_SPOT = 1
LIGHT_DIRECTIONAL = 2

WRAP_REPEAT = 0
WRAP_MIRROR = 1
WRAP_CLAMP = 2

MATERIAL_MASK = 1
MATERIAL_BLEND = 2
MATERIAL_UNLIT = 4
MATERIAL_SHINES = 8

MIRROR_ROUGHNESS = 0.04
"""Surfaces as smooth as this mirror single rays; rougher ones reflect lights alone, and paths along a lobe."""

RAY_REFLECTED = 1
RAY_REFRACTED = 2
RAY_INDIRECT = 3
"""Kinds of secondary rays."""

PAIRS_OF_HIT = 5
"""Pairs of random numbers that a path takes at a hit: light, point on it, way to go on, direction, roulette."""

ROULETTE_DEPTH = 3
"""Generation from which on paths may end by Russian roulette."""

LEAST_WAY = 2.0**-60
LARGEST_WAY = 2.0**60
"""Of the largest component of a ray's direction: what trace_rays.cl takes."""

THIN_ALPHA = 0.5
"""Blending surfaces under this alpha do not stop light outside of paths."""

NO_TEXTURE = 0xFFFFFFFF

PLANE_NONE = 0xFFFFFFFF
"""Of an output channel group: not asked for."""
