"""The artifact store: objects by content, and records of what stages computed.

Layout under the root::

    objects/ab/<sha256><suffix>   immutable content, read-only
    records/<stage>/<key>.json    one `StageRecord` for each cache key
    locks/<key>.lock              held while a key is computed; locks/store.lock by writers
    tmp/                          files being written
    damaged/                      objects whose content was found wrong
    prefect-results/              what Prefect keeps about the stage tasks (JSON)
    shared/<id of a URL>/         what is known of a shared store (`tasks.remote_tier`)

It knows nothing of Prefect: `Store.compute_once` is all that a library user needs::

    store = Store()
    key = stage_key("depth", 1, {"scene": scene.digest}, {"views": 6})
    record, computed = store.compute_once("depth", 1, key, lambda: {"book": store.put_arrays(...)})
    arrays = store.load_arrays(record.artifacts["book"])
"""

from __future__ import annotations

from gvr_core.errors import StoreError
from tasks.record_store import LookupCounts, StageFunction, StageOutput
from tasks.records import Artifact, StageRecord, canonical_json, stage_key
from tasks.remote_upkeep import (
    PushReport,
    collect_shared_garbage,
    list_shared,
    push_everything,
    verify_shared,
)
from tasks.shared_store import SharedStore
from tasks.upkeep import (
    GRACE_SECONDS,
    GcReport,
    Listing,
    VerifyReport,
    collect_garbage,
    list_records,
    verify_everything,
)

__all__ = [
    "Artifact",
    "GcReport",
    "Listing",
    "LookupCounts",
    "PushReport",
    "StageFunction",
    "StageOutput",
    "StageRecord",
    "Store",
    "StoreError",
    "VerifyReport",
    "canonical_json",
    "stage_key",
]


class Store(SharedStore):
    """The whole store: objects, records, and their upkeep.

    Args:
        root: The store's folder, or the URL of one that several machines share (its local
            folder is then `tasks.objects.local_root`); else the environment variable GVR_STORE,
            else ``.gvr/store`` under the current folder. Made at the first write.
    """

    def ls(self, stage: str | None = None) -> Listing:
        """The records, newest first, of one stage or of all."""
        return list_records(self, stage)

    def ls_shared(self) -> Listing:
        """What is in the shared store; see `tasks.remote_upkeep.list_shared`."""
        return list_shared(self)

    def push_all(self) -> PushReport:
        """Put into the shared store what it lacks; see `tasks.remote_upkeep.push_everything`."""
        return push_everything(self)

    def verify_shared(self) -> VerifyReport:
        """Check the shared store; see `tasks.remote_upkeep.verify_shared`."""
        return verify_shared(self)

    def gc_shared(
        self,
        keep_days: float | None = None,
        *,
        dry_run: bool = False,
        grace_seconds: float = GRACE_SECONDS,
    ) -> GcReport:
        """Collect in the shared store; see `tasks.remote_upkeep.collect_shared_garbage`."""
        return collect_shared_garbage(self, keep_days, dry_run=dry_run, grace_seconds=grace_seconds)

    def verify(self) -> VerifyReport:
        """Hash every object that a record names, and count those that none names."""
        return verify_everything(self)

    def gc(
        self,
        keep_days: float | None = None,
        *,
        dry_run: bool = False,
        grace_seconds: float = GRACE_SECONDS,
    ) -> GcReport:
        """Remove what no record refers to; see `tasks.upkeep.collect_garbage`.

        Args:
            keep_days: Also remove records not used for so many days; None keeps all records.
            dry_run: Only say what would be removed.
            grace_seconds: Spare anything younger, as a running stage may not have recorded it.

        Raises:
            StoreError: A negative number.
        """
        return collect_garbage(self, keep_days, dry_run=dry_run, grace_seconds=grace_seconds)
