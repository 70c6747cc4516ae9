"""Motion without end: a prompt that changes while it runs, a state that goes on to the last bit, files that grow."""

from moveset import MotionStream
from moveset.io.take_writer import open_take

stream = MotionStream.from_pretrained(prompt="a person walks forward", seed=7)
with open_take("stream.bvh", stream.codec.skeleton, stream.codec.fps) as take:
    for segment in stream:
        take.append(segment.motion)
        print(f"frame {segment.first_frame}: {segment.prompt}, made in {segment.latency_ms:.0f} ms")
        if segment.number == 2:
            print(f"sitting down from frame {stream.prompt('a person sits down')} on")
        if segment.number == 5:
            break

stream.save_state("stream.safetensors")
following = next(stream)
again = next(MotionStream.from_pretrained().load_state("stream.safetensors"))
print("the stored stream goes on alike:", bool((again.motion.rotations == following.motion.rotations).all()))

# From the end of another motion, by a timeline: prompts last a whole number of segments.
timeline = MotionStream.from_pretrained(
    prompt=["a person runs", "a person jumps"], seconds=[4.2, 2.8], seed_motion=following.motion, network="rdm"
)
print("prompts begin with segments", timeline.timeline.starts)
