"""The cards: everything that cyclekit stores as JSON with its tables, as typed values with units and limits.

In: the text of `dataset.json`, `model.json`, a stored recording or `cell.json`. Out: an immutable card, or one sentence
that names the wrong value and what was expected. A card may come from anywhere, so it is checked when it is opened.
Unknown keys are ignored, as another version may have written them. The rooms above define the use of the values.
"""

from cyclekit.dataset.cards.coupling import ConditionCard as ConditionCard
from cyclekit.dataset.cards.coupling import CouplingCard as CouplingCard
from cyclekit.dataset.cards.coupling import GateCard as GateCard
from cyclekit.dataset.cards.coupling import InTurnCard as InTurnCard
from cyclekit.dataset.cards.coupling import OperatorPaceCard as OperatorPaceCard
from cyclekit.dataset.cards.coupling import OwnWorkCard as OwnWorkCard
from cyclekit.dataset.cards.coupling import SourceCard as SourceCard
from cyclekit.dataset.cards.coupling import TripCard as TripCard
from cyclekit.dataset.cards.dataset import DatasetCard as DatasetCard
from cyclekit.dataset.cards.dataset import DynamicsCard as DynamicsCard
from cyclekit.dataset.cards.dataset import ExecutionCard as ExecutionCard
from cyclekit.dataset.cards.dataset import FileCard as FileCard
from cyclekit.dataset.cards.dataset import OperatorSignalCard as OperatorSignalCard
from cyclekit.dataset.cards.dataset import PlaceCard as PlaceCard
from cyclekit.dataset.cards.dataset import RowCounts as RowCounts
from cyclekit.dataset.cards.dataset import UnreadCard as UnreadCard
from cyclekit.dataset.cards.dataset import dataset_card as dataset_card
from cyclekit.dataset.cards.fleet import CellLedger as CellLedger
from cyclekit.dataset.cards.fleet import FiguresCard as FiguresCard
from cyclekit.dataset.cards.fleet import MonthCard as MonthCard
from cyclekit.dataset.cards.fleet import StageCard as StageCard
from cyclekit.dataset.cards.model import CellCard as CellCard
from cyclekit.dataset.cards.model import EpochCard as EpochCard
from cyclekit.dataset.cards.model import LevelShare as LevelShare
from cyclekit.dataset.cards.model import MetricsCard as MetricsCard
from cyclekit.dataset.cards.model import ModelCard as ModelCard
from cyclekit.dataset.cards.model import RowsCard as RowsCard
from cyclekit.dataset.cards.model import SpecCard as SpecCard
from cyclekit.dataset.cards.model import SplitCard as SplitCard
from cyclekit.dataset.cards.model import StandardisationCard as StandardisationCard
from cyclekit.dataset.cards.model import TrainingCard as TrainingCard
from cyclekit.dataset.cards.model import model_card as model_card
from cyclekit.dataset.cards.notes import IMPOSSIBLE as IMPOSSIBLE
from cyclekit.dataset.cards.notes import READ as READ
from cyclekit.dataset.cards.notes import TEXT as TEXT
from cyclekit.dataset.cards.notes import Note as Note
from cyclekit.dataset.cards.notes import note as note
from cyclekit.dataset.cards.notes import texts as texts
from cyclekit.dataset.cards.read import BadCard as BadCard
from cyclekit.dataset.cards.read import checked as checked
from cyclekit.dataset.cards.read import parse_json as parse_json
from cyclekit.dataset.cards.read import plain as plain
from cyclekit.dataset.cards.read import read_content as read_content
from cyclekit.dataset.cards.read import read_json as read_json
from cyclekit.dataset.cards.recording import ClockCard as ClockCard
from cyclekit.dataset.cards.recording import ClockMethod as ClockMethod
from cyclekit.dataset.cards.recording import ClockTest as ClockTest
from cyclekit.dataset.cards.recording import FrameCard as FrameCard
from cyclekit.dataset.cards.recording import LogCard as LogCard
from cyclekit.dataset.cards.recording import OperatorCard as OperatorCard
from cyclekit.dataset.cards.recording import RecordingCard as RecordingCard
from cyclekit.dataset.cards.recording import SetAside as SetAside
from cyclekit.dataset.cards.recording import SourceFile as SourceFile
