"""The commands motion/process, motion/view, motion/check and motion/list."""
