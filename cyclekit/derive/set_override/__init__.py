"""Whether people or a hand moved the override that was set, such as UR's speed slider or KUKA's $OV_PRO.

In: sessions whose robot logged such an override, and everything else that was logged. Out: runs whose scaling includes
it where it moves with people, with the slider that a hand set beside it. Used by `derive.passes`.
"""
