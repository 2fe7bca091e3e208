"""Maps of the public programs, scored.

The scores of the public scripts, and every label as by other libraries.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

import dynaviz as dv
from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context
from dynaviz.contracts.scan import Scan
from dynaviz.engine.external import ExternalMap
from dynaviz.io.pcd import write_pcd

# SA, DA and AA of the public scripts, on the small sequence
PRINTED = {
    "octomap": (92.87, 35.16, 57.14),
    "octomap_g": (95.04, 34.56, 57.31),
    "dufomap": (100, 23.94, 48.92),
    "beautymap": (90.30, 65.42, 76.86),
    "removert_port": (98.90, 17.42, 41.50),
}
ERASOR = {"mini": (89.65, 26.58, 48.82), "kitti_tracking_0012": (97.90, 80.86, 88.98)}


@pytest.mark.parametrize("program", PRINTED)
def test_maps_of_the_public_programs_score_as_in_the_public_scripts(mini, tmp_path, program):
    kept = mini.points[~mini.removed[program]]
    write_pcd(tmp_path / "map.pcd", dict(zip("xyz", kept.T, strict=True)))
    result = dv.score(tmp_path / "map.pcd", dv.open(mini.shared / "golden/mini"))
    assert [result.metrics[name] for name in ("SA", "DA", "AA")] == pytest.approx(
        PRINTED[program], abs=0.005
    )


def test_scores_of_the_erasor_map_match_scipy_and_open3d(golden):
    import open3d as o3d

    path = golden.shared / f"golden/erasor/{golden.name}.pcd"
    labelled = golden.truth < 2
    points = golden.points[labelled]
    scored = ExternalMap(path, "erasor")
    scored.begin(Context(Extent.of(*golden.scans)))
    removed = scored.label(Scan(0, points, np.eye(4))).dynamic
    distance, _ = cKDTree(scored.points.astype(np.float64)).query(
        points.astype(np.float64), workers=-1
    )
    on_the_border = np.abs(distance - 0.05) < 1e-8
    assert np.array_equal(removed[~on_the_border], distance[~on_the_border] > 0.05)
    some = slice(None, None, 50)
    clouds = [
        o3d.geometry.PointCloud(o3d.utility.Vector3dVector(xyz))
        for xyz in (points[some], scored.points)
    ]
    theirs = np.asarray(clouds[0].compute_point_cloud_distance(clouds[1]))
    assert np.array_equal(removed[some][~on_the_border[some]], theirs[~on_the_border[some]] > 0.05)
    everywhere = np.zeros(len(golden.truth), bool)
    everywhere[labelled] = removed
    assert golden.scores(everywhere) == pytest.approx(ERASOR[golden.name], abs=0.005)
