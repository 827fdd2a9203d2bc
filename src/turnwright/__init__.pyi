from . import (
    access as access,
)
from . import (
    cutting as cutting,
)
from . import (
    diagnosis as diagnosis,
)
from . import (
    errors as errors,
)
from . import (
    files as files,
)
from . import (
    generation as generation,
)
from . import (
    heightmap as heightmap,
)
from . import (
    instrument as instrument,
)
from . import (
    job as job,
)
from . import (
    machine as machine,
)
from . import (
    material as material,
)
from . import (
    metrology as metrology,
)
from . import (
    motion as motion,
)
from . import (
    part as part,
)
from . import (
    path as path,
)
from . import (
    placing as placing,
)
from . import (
    pose as pose,
)
from . import (
    post as post,
)
from . import (
    profile as profile,
)
from . import (
    progress as progress,
)
from . import (
    strategy as strategy,
)
from . import (
    studies as studies,
)
from . import (
    surface as surface,
)
from . import (
    tool as tool,
)
from . import (
    tracking as tracking,
)
from . import (
    units as units,
)
from .access import (
    check_access as check_access,
)
from .errors import (
    CorrectionError as CorrectionError,
)
from .errors import (
    GougeError as GougeError,
)
from .errors import (
    InputError as InputError,
)
from .errors import (
    JobError as JobError,
)
from .errors import (
    LimitError as LimitError,
)
from .errors import (
    TurnwrightError as TurnwrightError,
)
from .files import (
    read_map as read_map,
)
from .files import (
    read_profile as read_profile,
)
from .files import (
    write_map as write_map,
)
from .generation import (
    generate as generate,
)
from .generation import (
    generate_points as generate_points,
)
from .generation import (
    generate_polar as generate_polar,
)
from .heightmap import (
    HeightMap as HeightMap,
)
from .instrument import (
    Instrument as Instrument,
)
from .job import (
    Job as Job,
)
from .job import (
    compare as compare,
)
from .job import (
    correct as correct,
)
from .job import (
    diagnose as diagnose,
)
from .job import (
    measure as measure,
)
from .job import (
    plan as plan,
)
from .job import (
    run as run,
)
from .machine import (
    Axis as Axis,
)
from .machine import (
    Controller as Controller,
)
from .machine import (
    Machine as Machine,
)
from .material import (
    Material as Material,
)
from .metrology import (
    lenslets as lenslets,
)
from .metrology import (
    register as register,
)
from .metrology import (
    remove_form as remove_form,
)
from .metrology import (
    roughness as roughness,
)
from .motion import (
    SpeedProfile as SpeedProfile,
)
from .motion import (
    check_limits as check_limits,
)
from .motion import (
    drive as drive,
)
from .part import (
    Blank as Blank,
)
from .part import (
    Part as Part,
)
from .path import (
    Motion as Motion,
)
from .path import (
    Path as Path,
)
from .path import (
    Spiral as Spiral,
)
from .placing import (
    place as place,
)
from .pose import (
    Pose as Pose,
)
from .post import (
    inspect_nc as inspect_nc,
)
from .post import (
    read_nc as read_nc,
)
from .post import (
    write_nc as write_nc,
)
from .profile import (
    Profile as Profile,
)
from .strategy import (
    AdaptiveToolServo as AdaptiveToolServo,
)
from .strategy import (
    FastToolServo as FastToolServo,
)
from .strategy import (
    HybridToolServo as HybridToolServo,
)
from .strategy import (
    QuasiEllipticalToolServo as QuasiEllipticalToolServo,
)
from .strategy import (
    SlowToolServo as SlowToolServo,
)
from .surface import (
    Biconic as Biconic,
)
from .surface import (
    Conic as Conic,
)
from .surface import (
    EvenAsphere as EvenAsphere,
)
from .surface import (
    Expression as Expression,
)
from .surface import (
    Forbes as Forbes,
)
from .surface import (
    Gridded as Gridded,
)
from .surface import (
    LensArray as LensArray,
)
from .surface import (
    OffAxis as OffAxis,
)
from .surface import (
    Plane as Plane,
)
from .surface import (
    RadialPolynomial as RadialPolynomial,
)
from .surface import (
    Scattered as Scattered,
)
from .surface import (
    SineGrid as SineGrid,
)
from .surface import (
    Sphere as Sphere,
)
from .surface import (
    Surface as Surface,
)
from .surface import (
    Toroid as Toroid,
)
from .surface import (
    XYPolynomial as XYPolynomial,
)
from .surface import (
    Zernike as Zernike,
)
from .tool import (
    Tool as Tool,
)
from .tool import (
    WavinessTable as WavinessTable,
)
from .tracking import (
    precorrect as precorrect,
)
from .tracking import (
    track as track,
)

__version__: str
