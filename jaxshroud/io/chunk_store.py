"""Zarr's store in a folder, each of whose files appears completely or not at all; it imports Zarr."""

import asyncio

from zarr.core.buffer import Buffer
from zarr.storage import LocalStore

from jaxshroud.whole_file import write_whole


class ChunkStore(LocalStore):
    """A folder of arrays to which chunks are written whole, without files that a killed process would leave."""

    async def set(self, key: str, value: Buffer) -> None:
        """Write a file of the store."""
        await asyncio.to_thread(self.set_sync, key, value)

    def set_sync(self, key: str, value: Buffer) -> None:
        """Write a file of the store, which the disk need not have at once: its record has a digest of it."""
        path = self.root / key
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, value.to_bytes(), synced=False)
