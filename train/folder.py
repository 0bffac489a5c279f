"""The files of a run's folder."""

ACTOR_FILE = "actor.onnx"
CLIP_FILE = "motion.npz"  # of a clip set the first
CLIPS_FOLDER = "clips"
CONFIG_FILE = "config.yaml"
CURVES_FILE = "curves.png"
COMPANION_FILE = "learner.npz"  # world model, for init_from
METRICS_FILE = "metrics.jsonl"
REPORT_FILE = "report.html"
SUMMARY_FILE = "summary.json"
