"""What a clip gets last: ends in the default pose, a seam to play it in a loop, its mirror image."""

from motion.finish.ends import with_default_ends
from motion.finish.loop import loop_clip
from motion.finish.mirror import mirror_clip

__all__ = ["loop_clip", "mirror_clip", "with_default_ends"]
