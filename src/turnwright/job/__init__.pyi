from .approach import (
    Entry as Entry,
)
from .comparison import (
    Candidate as Candidate,
    Comparison as Comparison,
    compare as compare,
)
from .contributions import (
    ErrorBreakdown as ErrorBreakdown,
    break_down_error as break_down_error,
    has_servos as has_servos,
    without_servos as without_servos,
)
from .correction import (
    Correction as Correction,
    correct as correct,
)
from .cusps import (
    CuspLight as CuspLight,
)
from .finish_terms import (
    Finish as Finish,
    finish as finish,
)
from .first_run import (
    compile_simulation as compile_simulation,
    compile_simulation_ahead as compile_simulation_ahead,
)
from .links import (
    find_wrong_move as find_wrong_move,
)
from .measurement import (
    Measured as Measured,
    diagnose as diagnose,
    measure as measure,
    read_measurement as read_measurement,
)
from .optics import (
    OpticalPerformance as OpticalPerformance,
    measured_optics as measured_optics,
)
from .pass_plan import (
    PassPlan as PassPlan,
)
from .pipeline import (
    Pipeline as Pipeline,
)
from .planning import (
    Plan as Plan,
    Trial as Trial,
    plan as plan,
)
from .predicting import (
    predict as predict,
)
from .prediction import (
    Prediction as Prediction,
)
from .programs import (
    predicted_motion as predicted_motion,
    program_shares as program_shares,
)
from .reference import (
    job_schema as job_schema,
)
from .result import (
    Pass as Pass,
    Preview as Preview,
    Result as Result,
)
from .running import (
    finishing_motion as finishing_motion,
    preview as preview,
    run as run,
)
from .schema import (
    Job as Job,
    faults as faults,
)
from .shape import (
    PartShape as PartShape,
    part_shape as part_shape,
)
from .tables import (
    HeightFile as HeightFile,
    MachineDeviations as MachineDeviations,
    Table as Table,
    context_of as context_of,
    name_keys as name_keys,
)
from .template import (
    job_template as job_template,
    part_template as part_template,
    reference_tables as reference_tables,
)
from .testparts import (
    TestPartKind as TestPartKind,
    make_test_part as make_test_part,
)
from .text import (
    as_tables as as_tables,
    edit_text as edit_text,
    write_job as write_job,
)
from .time_estimate import (
    steps_of_comparison as steps_of_comparison,
    steps_of_correction as steps_of_correction,
    steps_of_diagnosis as steps_of_diagnosis,
    steps_of_measurement as steps_of_measurement,
    steps_of_plan as steps_of_plan,
    steps_of_prediction as steps_of_prediction,
    steps_of_preview as steps_of_preview,
    steps_of_run as steps_of_run,
)
from .verdict import (
    Verdict as Verdict,
    any_missed as any_missed,
    judge as judge,
    judge_form as judge_form,
    not_evaluated as not_evaluated,
)
