"""The length predictor learns how long sentences last; that it resumes exactly is a test of the pipeline."""


def test_lengths_are_learned(tiny_run, tmp_path):
    def validated(into, *settings, steps):
        return tiny_run.train("length", tmp_path / into, *settings, steps=steps, validate_every=steps)[1].validation

    before, after = validated("none", steps=1), validated("some", "lr=0.03", steps=20)
    assert after["median_error"] < before["median_error"]
    assert after["constant_error"] == before["constant_error"]
