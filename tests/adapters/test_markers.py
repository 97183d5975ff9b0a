"""Which marker names are the pelvis, whoever gave them: the person is where these are."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cyclekit_adapters.tracking.markers import is_pelvis

PELVIS = {
    "Plug-in Gait": ["LASI", "RASI", "LPSI", "RPSI", "SACR"],
    "ISB": ["L_IAS", "R_IAS", "L_IPS", "R_IPS"],
    "ISB in one word": ["LIAS", "RIAS", "LIPS", "RIPS"],
    "BTS": ["r asis", "l asis", "sacrum"],
    "OpenSim": ["R.ASIS", "L.ASIS", "V.Sacral"],
    "OpenCap": ["r.ASIS_study", "L.ASIS_study", "r.PSIS_study", "L.PSIS_study", "RHJC_study", "LHJC_study"],
    "Qualisys": ["WaistLFront", "WaistRBack", "ASISl", "PSISr"],
    "HALPE": ["Hip", "RHip", "LHip"],
    "BODY_25": ["CHip", "MidHip"],
    "in words": ["left_hip", "RIGHT_HIP", "Pelvis", "hip_center"],
}
OTHERS = {
    "ISB": ["R_HM", "R_HM2", "L_FTC", "L_FLE", "SJN", "CV7", "TV10", "L_SIA"],
    "BTS": ["r should", "r thigh", "r bar 1", "r knee 1", "r mall", "r heel", "r met", "c7"],
    "HALPE": ["Nose", "Head", "Neck", "RKnee", "LBigToe", "RSmallToe"],
    "face": ["lips", "Lips", "chin"],
    "things": ["ship", "chip_1", "rib", "tip", "hipster", "*7", ""],
}


@pytest.mark.parametrize("name", [name for names in PELVIS.values() for name in names])
@pytest.mark.parametrize("subject", ["", "Ann:"])
def test_the_pelvis_is_known_by_the_names_of_each_marker_set(name, subject):
    assert is_pelvis(subject + name)


@pytest.mark.parametrize("name", [name for names in OTHERS.values() for name in names])
def test_other_points_of_the_body_are_not_the_pelvis(name):
    assert not is_pelvis(name)


@given(
    name=st.sampled_from([name for names in PELVIS.values() for name in names if not name.endswith("IPS")]),
    mark=st.sampled_from(["_", ".", " ", "-"]),
    upper=st.booleans(),
)
def test_case_and_separator_make_no_difference(name, mark, upper):
    spelt = name.replace("_study", "").replace("_", mark).replace(".", mark).replace(" ", mark)
    assert is_pelvis(spelt.upper() if upper else spelt.lower())


@given(st.text(max_size=30))
def test_any_name_has_an_answer(name):
    assert is_pelvis(name) in (True, False)
