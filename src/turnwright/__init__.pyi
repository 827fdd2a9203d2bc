from . import (
    access as access,
    chuck as chuck,
    cutting as cutting,
    diagnosis as diagnosis,
    errors as errors,
    files as files,
    generation as generation,
    heightmap as heightmap,
    instrument as instrument,
    job as job,
    machine as machine,
    material as material,
    metrology as metrology,
    motion as motion,
    optics as optics,
    outline as outline,
    part as part,
    path as path,
    placing as placing,
    pose as pose,
    post as post,
    profile as profile,
    progress as progress,
    strategy as strategy,
    studies as studies,
    surface as surface,
    tool as tool,
    tracking as tracking,
    units as units,
)
from .access import (
    check_access as check_access,
)
from .chuck import (
    Chuck as Chuck,
    Mounted as Mounted,
)
from .errors import (
    CorrectionError as CorrectionError,
    GougeError as GougeError,
    InputError as InputError,
    JobError as JobError,
    LimitError as LimitError,
    TurnwrightError as TurnwrightError,
)
from .files import (
    read_map as read_map,
    read_profile as read_profile,
    write_map as write_map,
)
from .generation import (
    generate as generate,
    generate_points as generate_points,
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
    compare as compare,
    correct as correct,
    diagnose as diagnose,
    measure as measure,
    plan as plan,
    run as run,
)
from .machine import (
    Axis as Axis,
    Controller as Controller,
    Machine as Machine,
)
from .material import (
    Material as Material,
)
from .metrology import (
    lenslets as lenslets,
    register as register,
    remove_form as remove_form,
    roughness as roughness,
)
from .motion import (
    check_limits as check_limits,
    drive as drive,
)
from .outline import Outline as Outline
from .part import (
    Blank as Blank,
    Part as Part,
)
from .path import (
    Motion as Motion,
    Path as Path,
    Spiral as Spiral,
)
from .placing import (
    place as place,
)
from .pose import (
    Pose as Pose,
)
from .post import (
    read_nc as read_nc,
    write_nc as write_nc,
)
from .profile import (
    Profile as Profile,
)
from .speed_profile import SpeedProfile as SpeedProfile
from .strategy import (
    AdaptiveToolServo as AdaptiveToolServo,
    FastToolServo as FastToolServo,
    HybridToolServo as HybridToolServo,
    QuasiEllipticalToolServo as QuasiEllipticalToolServo,
    SlowToolServo as SlowToolServo,
    Turning as Turning,
)
from .surface import (
    Biconic as Biconic,
    Conic as Conic,
    EvenAsphere as EvenAsphere,
    Expression as Expression,
    Forbes as Forbes,
    Gridded as Gridded,
    LensArray as LensArray,
    OffAxis as OffAxis,
    Plane as Plane,
    RadialPolynomial as RadialPolynomial,
    Scattered as Scattered,
    SineGrid as SineGrid,
    Sphere as Sphere,
    Surface as Surface,
    Toroid as Toroid,
    XYPolynomial as XYPolynomial,
    Zernike as Zernike,
)
from .tool import (
    Shank as Shank,
    Tool as Tool,
    WavinessTable as WavinessTable,
)
from .tracking import (
    precorrect as precorrect,
    track as track,
)

__version__: str
