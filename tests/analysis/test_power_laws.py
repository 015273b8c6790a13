

def test_no_point_is_a_sentence():
    with pytest.raises(InputError, match="got 0"):
        fit_power_law([], [])
