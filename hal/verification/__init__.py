"""The guided check that motors, joints and IMU are what the files say, and the record that they were."""
