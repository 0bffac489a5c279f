"""What an actor is to follow, tick by tick: a clip, people's sticks, a script, or another program."""
