"""train/run.py --print: where each value comes from."""

from train.run import main


def printed(capsys, *arguments):
    assert main([*arguments, "--print"]) == 0
    lines = capsys.readouterr().out.splitlines()
    return dict(line.split(" = ", 1) for line in lines)


def test_every_key_names_the_last_layer_that_set_it(capsys):
    shown = printed(capsys, "motion=stand", "train=last_mile", "seed=3", "threads=1", "precision=auto", "sigma=medium")
    preset = "configs/train/train/"
    assert shown["seed"] == "3    # command line"
    assert shown["value"] == "vector    # configs/train/config.yaml"
    assert shown["learner.noise_std"] == f"0.08    # {preset}last_mile.yaml"
    assert shown["learner.gamma"] == f"0.99    # {preset}window.yaml"
    assert shown["device"].split("    # ")[1] == "this machine"
    assert shown["environment.rewards.max_joint.sigma"] == "0.3    # sigma=medium"


def test_a_section_given_at_once_is_from_the_command_line_too(capsys):
    shown = printed(capsys, "motion=stand", "train=window", "learner.losses={entropy: 0.5}")
    assert shown["learner.losses.entropy"] == "0.5    # command line"


def test_an_unusable_configuration_is_not_printed(capsys):
    assert main(["motion=stand", "num_envs=0", "--print"]) == 2
    assert capsys.readouterr().out == ""


def test_one_clip_alone_goes_on_from_the_bundled_tracker(capsys):
    assert printed(capsys, "motion=stand")["init_from"] == "tracker    # configs/train/train/clip.yaml"
    assert printed(capsys, "motion=stand", "init_from=none")["init_from"] == "null    # command line"


def test_many_clips_alone_mean_the_tracker_and_a_preset_builds_on_another(capsys):
    shown = printed(capsys, "motions=clips", "seed=3")
    assert shown["world_model.round"] == "2    # configs/train/train/tracker.yaml"
    assert shown["init_from"] == "null    # configs/train/config.yaml"
    shown = printed(capsys, "motions=clips", "train=window")
    assert shown["environment.observations"] == "window    # configs/train/train/window.yaml"
    shown = printed(capsys, "motions=clips", "train=goals")
    assert shown["environment.observations"] == "goals    # configs/train/train/goals.yaml"
    assert shown["world_model.round"] == "2    # configs/train/train/tracker.yaml"
