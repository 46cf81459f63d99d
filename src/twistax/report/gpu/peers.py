"""Other packages on the same GPU: accelerations of the Panda's joints, without contacts and limits."""

from __future__ import annotations

import importlib.metadata
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax

_PACKAGE = Path(__file__).parents[2]


def _panda() -> str:
    folders = (_PACKAGE / "examples", _PACKAGE.parents[1] / "examples")
    return str(next(folder / "panda.urdf" for folder in folders if folder.is_dir()))


def _mjx() -> tuple[str, Callable[..., Any]]:
    import mujoco
    from mujoco import mjx

    model = mujoco.MjModel.from_xml_path(_panda())
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    there = mjx.put_model(model, impl="jax")
    start = mjx.make_data(model, impl="jax")

    def one(q: Any, qd: Any, tau: Any) -> Any:
        return mjx.forward(there, start.replace(qpos=q, qvel=qd, qfrc_applied=tau)).qacc

    return f"MJX {importlib.metadata.version('mujoco-mjx')}, forward", jax.vmap(one)


def _frax() -> tuple[str, Callable[..., Any]]:
    from frax.core.manipulator import Manipulator

    with tempfile.TemporaryDirectory() as folder:
        # It needs an inertia of the base too, which does not move.
        inertial = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
        file = Path(folder, "panda.urdf")
        file.write_text(Path(_panda()).read_text().replace('name="link0"/>', f'name="link0">{inertial}</link>'))
        arm = Manipulator(str(file))
    name = f"frax {importlib.metadata.version('frax')}, forward_dynamics"
    return name, jax.vmap(lambda q, qd, tau: arm.forward_dynamics(q, qd, tau, None))


#: By the name of the package, what makes a function of batches, with its name. Each raises ImportError.
PEERS: Mapping[str, Callable[[], tuple[str, Callable[..., Any]]]] = {"mjx": _mjx, "frax": _frax}
