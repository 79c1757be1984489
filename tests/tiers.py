"""Which tests are run when, by the processor time that they were measured to take.

`quick` by file; further tests that are `slow` or `long` by name. Marks beside a test say the same
of those that were written as such. A test is moved where another one of its tier computes the same
public function, or runs the same engine, on another rig, law or case; the dearest ones go first.
"""

QUICK = {
    *("test_beam", "test_drive", "test_elastic_pendulum"),
    *("test_zipped_axes", "test_replay", "test_poincare", "test_single_contact"),
    *("test_folds", "test_period_number", "test_lyapunov", "test_bifurcation"),
    *("test_map_chunks", "test_regime_map", "test_identification_plot", "test_saving"),
    *("test_measured_curve", "test_measured_files", "test_measured_history"),
    *("test_measured_responses", "test_rig_file", "test_cli_fit", "test_interrupts"),
    *("test_tiers", "test_public_names", "test_documentation", "test_notebooks", "test_resolution"),
    *("test_experiment_gandhi_vyas", "test_cli_cache", "test_propagate", "test_robust"),
}
"""Files whose tests, but for the slow ones, are run all the time: some of every room."""

SLOW = {
    "test_continue_response": ("test_grazings_are_where_the_free_motion_fills_the_gap",),
    "test_energy_flow": ("test_shares_and_the_dataset",),
    "test_free_bodies": (
        "test_without_loss_a_ball_comes_back_to_where_it_fell_from",
        "test_a_free_body_on_a_base_that_vibrates",
    ),
    "test_cli": (
        "test_sweep_of_the_default_rig",
        "test_sweep_of_a_file_in_hertz",
        "test_a_failure_while_writing_leaves_nothing",
    ),
    "test_linearly_implicit": (
        "test_single_mass_converges_to_the_exact_motion",
        "test_steps_too_long_for_the_damping_are_refused",
    ),
    "test_contact_laws": (
        "test_histories_agree_with_scipy_and_with_other_solvers",
        "test_histories_go_on_from_where_another_ended",
    ),
    "test_exact_contact": (
        "test_overdamped_stops_that_cannot_pull_cost_by_their_contacts",
        "test_a_lane_that_blows_up_leaves_its_neighbours_alone",
        "test_period_of_an_undamped_mass",
        "test_overdamped_single_mass",
        "test_restitution_of_a_kelvin_voigt_stop",
        "test_elastic_stop_keeps_the_energy",
    ),
    "test_map_interrupted": (
        "test_death_before_any_change_of_the_files_is_mended_by_the_same_call",
        "test_a_full_disk_is_said_and_no_harm_wherever_it_happens",
    ),
    "test_wrong_calls": ("test_junk_is_answered_by_a_sentence_that_names_the_argument",),
    "test_parameter_map": (
        "test_zipped_axes_are_the_diagonal",
        "test_chunks_and_order_of_axes_change_nothing",
        "test_a_measure_that_returns_a_curve_is_told_so",
        "test_quiet_where_there_is_no_terminal",
        "test_measures_of_ones_own",
    ),
    "test_regime_map": ("test_a_map_is_its_bifurcation_diagrams",),
    "test_settling": (
        "test_highest_point_of_the_upper_branch",
        "test_found_orbits_close_on_themselves",
        "test_cost_is_counted",
        "test_not_settled_is_flagged",
        "test_lost_lane_is_flagged_and_starts_again_from_rest",
        "test_starting_on_the_orbit_stays_there",
        "test_response_curve_of_a_system_of_ones_own",
        "test_period_doubling_where_it_is_known",
    ),
    "test_history_misfit": (
        "test_derivative_follows_the_shift",
        "test_nonsense_lane_leaves_its_neighbour_alone",
    ),
    "test_periodic_response": (
        "test_systems_that_are_not_linear_are_shot",
        "test_the_largest_of_several_forces_is_found",
        "test_a_failed_search_is_flagged",
    ),
    "test_resolution": ("test_a_motion_without_contact_has_no_change_of_its_force",),
    "test_map_store": (
        "test_a_lock_ends_with_its_process",
        "test_a_lock_left_in_a_complete_store_is_removed",
        "test_a_second_thread_is_refused_too",
    ),
    "test_simulate_lists": (
        "test_every_lane_is_that_of_a_single_call",
        "test_initial_states_and_a_chirp",
    ),
    "test_identify": (
        "test_a_curve_without_contact_is_refused",
        "test_repetitions_side_by_side_are_what_they_are_alone",
        "test_recovers_the_stiffness_and_bounds_the_damping",
    ),
    "test_splitting": (
        "test_force_gradient_beats_the_plain_kick",
        "test_sweep_with_a_rounded_stop_agrees_with_exact_contact",
        "test_linear_response_is_exact_at_any_step",
    ),
    "test_basins": (
        "test_a_barrier_that_is_not_crossed",
        "test_results_do_not_depend_on_neighbours_or_order",
        "test_new_numbers_do_not_compile_again",
        "test_random_starts_and_axes",
        "test_dataset_file_and_picture",
        "test_a_map_of_basin_fractions",
    ),
    "test_regimes": (
        "test_kinds_of_the_impact_oscillator",
        "test_random_starts_are_the_same_for_a_seed_and_lie_outside_of_the_stop",
        "test_energies_of_a_linear_motion",
        "test_strobes_and_spectrum_show_the_period",
        "test_lanes_do_not_know_of_each_other",
        "test_dataset_file_and_pictures",
        "test_a_lane_that_is_lost_is_flagged_and_spares_the_others",
        "test_free_and_forced_oscillations_together_are_quasi_periodic",
    ),
    "test_simulate": (
        "test_any_implicit_solver_runs",
        "test_spectrum_reads_the_amplitude_of_a_sine",
        "test_rates_and_accelerations_are_derivatives",
    ),
    "test_contacts": (
        "test_releases_agree_with_the_reference",
        "test_kelvin_voigt_returns_what_its_closed_form_says",
        "test_the_table_reads_well",
    ),
    "test_resonance": (
        "test_histories_at_resonance_match_an_adaptive_solver",
        "test_with_a_stop_the_motion_is_computed",
        "test_a_sweep_says_what_grows_without_bound_and_does_not_march_it",
        "test_only_undamped_driven_modes_that_no_stop_holds_grow_without_bound",
    ),
    "test_condensed": ("test_condensed_solution_solves_the_linearised_balance",),
    "test_explore": (
        "test_the_live_curve_is_the_branch",
        "test_the_orbit_is_the_one_of_its_point",
        "test_other_numbers_compile_nothing",
        "test_a_slider_moves_the_picture",
    ),
    "test_map_identity": ("test_chunks_of_corrected_lanes_and_only_they_are_computed_again",),
    "test_frequency_sweep": ("test_axes_equal_one_by_one",),
    "test_lyapunov": (
        "test_linear_oscillator_decays_at_its_damping",
        "test_chaotic_motion_has_a_positive_exponent_beyond_its_error",
        "test_undamped_motion_has_a_zero_exponent",
    ),
    "test_single_contact": ("test_picture",),
    "test_compiling": tuple(
        f"test_nothing_compiles_again[{study}]"
        for study in (
            "periodic_response_history",
            "simulate_a_list",
            "single_contact_response",
            "frequency_sweep_refined",
            "continue_response",
            "continue_response_in_a_number",
            "branch_resample",
            "explore",
            "parameter_map_of_sweeps",
            "simulate",
            "history_contacts",
        )
    ),
    "test_walks": (
        "test_a_motion_that_touches_from_the_start",
        "test_a_force_that_jumps_makes_a_corner",
        "test_a_walk_does_not_turn_round_at_a_touch",
        "test_special_points_do_not_depend_on_range_and_step",
        "test_points_keep_to_the_equations",
    ),
    "test_following": (
        "test_where_a_motion_doubles_its_period_the_sweep_does",
        "test_means_are_exact",
        "test_it_is_the_sweep_that_marches_to_every_point",
        "test_most_points_are_not_marched_to",
    ),
    "test_jumps_at_folds": (
        "test_none_is_found_that_lies_too_far_or_the_other_way",
        "test_it_is_the_fold_of_the_branch_on_any_grid",
    ),
    "test_gauge": (
        "test_extremes_do_not_depend_on_how_finely_it_is_measured",
        "test_a_march_with_measures_goes_the_same_way",
        "test_measures_have_forward_derivatives",
        "test_more_stretches_than_there_is_room_for_at_once",
        "test_integrals_and_extremes_of_one_mode_in_closed_form",
    ),
    "test_rig_file": ("test_settings_go_into_a_sweep",),
    "test_matrix_system": ("test_free_decay_with_a_dashpot_through_a_contact",),
    "test_cache": (
        "test_broken_files_are_as_good_as_none",
        "test_a_cache_of_jax_that_the_user_has_set_is_left_alone",
        "test_two_processes_at_once_agree",
        "test_an_impossible_folder_is_one_warning",
        "test_another_process_traces_nothing",
    ),
    "test_internal_states": ("test_stops_that_relax_march_as_scipy_integrates_them",),
    "test_restitution": ("test_derivatives",),
    "test_excitation": ("test_phases_lead_the_drive",),
    "test_bifurcation": ("test_period_doubling_is_bracketed_in_both_directions",),
    "test_residual_shapes": ("test_check_resolution_recommends_it",),
}
"""By file: tests of several seconds."""

LONG = {
    "test_signals_in_histories": (
        "test_derivatives_are_those_of_differences[forward]",
        "test_other_laws_follow_the_signal_too",
        "test_other_samples_of_the_same_motion",
    ),
    "test_isolas": ("test_its_folds_are_those_along_the_amplitude",),
    "test_continue_response": (
        "test_branches_along_another_number_end_at_the_ends_of_its_range",
        "test_branches_end_at_the_ends_of_their_range",
    ),
    "test_cycles": ("test_chirp_of_the_elastic_pendulum_locks_at_three_drive_periods",),
    "test_records": (
        "test_sensors_are_fitted_on_clocks_of_their_own",
        "test_derivatives_in_numbers_of_records",
    ),
    "test_internal_states_fits": (
        "test_histories_of_a_stop_that_relaxes_have_no_misfit_at_the_truth[signal]",
        "test_load_and_gap_from_a_curve_of_voltage_or_power",
    ),
    "test_harvester": (
        "test_inductances_are_in_the_circuit_where_they_are_said_to_be[parallel]",
        "test_without_coupling_the_beam_moves_as_without_a_circuit",
        "test_power_has_derivatives_by_load_and_gap",
        "test_inductances_are_in_the_circuit_where_they_are_said_to_be[series]",
    ),
    "test_regime_map": ("test_only_periodic_motions_have_derivatives",),
    "test_impact_law": ("test_stiff_stops_tend_to_an_impact",),
    "test_internal_states": (
        "test_periodic_motions_of_stops_that_relax_return_and_are_balanced_too",
        "test_numbers_of_a_state_space_are_axes_and_have_derivatives",
        "test_derivatives_by_numbers_of_a_stop_that_relaxes",
        "test_modes_that_neither_stop_nor_response_see_are_internal_states",
        "test_stops_that_relax_march_as_scipy_integrates_them[chain]",
    ),
    "test_compiling": tuple(
        f"test_nothing_compiles_again[{study}]"
        for study in (
            "branch_switch",
            "periodic_response_guessed",
            "periodic_response_balanced",
            "continue_response_from_settled_marches",
            "continue_response_over_axes",
            "continue_response_balanced",
            "continue_response_from_a_motion",
            "basins_of_a_plane",
            "basins_history",
            "bifurcation_diagram_in_a_number",
            "identify_a_curve_from_several_starts",
            "identify_by_optax",
            "identification_branch",
            "identification_profile",
            "identification_what_next",
            "parameter_map_of_regimes",
            "parameter_map_of_basins",
            "gradient_of_fold_response",
            "gradient_of_simulate",
            "explore_a_picture",
            "parameter_map_of_branches",
            "periodic_response_shot",
            "identify_a_history",
            "check_resolution",
            "parameter_map_with_gradients",
            "parameter_map_of_periodic_responses",
            "fold_response",
            "fold_curves",
            "regimes",
            "basins",
            "bifurcation_diagram",
            "gradient_of_periodic_response",
            "periodic_response",
            "identify_a_curve",
            "lyapunov_exponent",
            "simulate_a_release",
        )
    ),
    "test_experiment_design": ("test_measures_of_the_maps_are_near_the_exact_ones",),
    "test_joined": (
        "test_start_up_agrees_with_scipy[beam]",
        "test_derivatives_of_two_equal_beams",
        "test_a_heavy_stiff_second_body_is_a_fixed_stop",
        "test_periodic_responses_sweeps_and_branches_agree_with_scipy[beam]",
        "test_the_numbers_of_either_body_are_axes",
        "test_start_up_agrees_with_scipy[mass]",
        "test_bodies_that_do_not_meet_move_as_each_alone",
        "test_states_places_and_what_modes_leave_out",
    ),
    "test_free_bodies": (
        "test_a_load_moves_the_gap",
        "test_a_loaded_pair_moves_about_where_it_rests",
        "test_two_masses_that_nothing_holds",
        "test_derivatives_of_the_velocity_after_the_bounce",
        "test_two_free_bodies_that_meet",
    ),
    "test_notebooks": (
        "test_runs_on_small_grids[01_first_response]",
        "test_runs_on_small_grids[04_identification]",
        "test_runs_on_small_grids[02_what_the_stop_does]",
        "test_runs_on_small_grids[07_soft_support]",
        "test_runs_on_small_grids[09_performance_and_precision]",
        "test_runs_on_small_grids[05_own_contact_law]",
        "test_runs_on_small_grids[06_own_system]",
        "test_runs_on_small_grids[08_pendulum_regimes]",
    ),
    "test_folds": ("test_forward_and_reverse_gradients_of_a_fold_agree",),
    "test_contacts": (
        *(f"test_steady_motions_agree_with_the_reference[{k}]" for k in range(11)),
        *(f"test_releases_agree_with_the_reference[{k}]" for k in range(1, 22) if k != 16),
        "test_coarse_samples_have_the_peaks_of_fine_ones",
        "test_how_finely_one_samples_does_not_matter",
        "test_largest_force_of_the_start_up_agrees_with_the_reference",
    ),
    "test_wrong_calls": ("test_any_junk_for_any_argument_is_answered_by_a_sentence",),
    "test_contact_laws": (
        "test_histories_agree_with_scipy_and_with_other_solvers[rubber]",
        "test_histories_agree_with_scipy_and_with_other_solvers[hertz]",
        "test_sweep_shooting_and_balance_find_the_same_motion[hunt_crossley]",
        "test_sweep_shooting_and_balance_find_the_same_motion[rubber]",
        "test_gradients_of_a_history[hertz]",
        "test_gradients_of_a_history[hunt_crossley]",
        "test_gradients_of_a_history[rubber]",
        "test_gradients_of_a_history[kelvin_voigt]",
        "test_rubber_with_a_short_memory_is_a_spring",
        "test_histories_agree_with_scipy_and_with_other_solvers[hunt_crossley]",
    ),
    "test_simulate": (
        "test_reverse_mode_goes_as_far_as_forward_mode[50]",
        "test_gradients_nest_with_vmap",
        "test_reverse_mode_matches_forward_mode_where_intervals_take_many_attempts",
        "test_gradient_of_splitting_matches_finite_differences",
        "test_chirp_of_equal_ends_is_the_harmonic",
        "test_chirp_matches_an_adaptive_solver",
        "test_dataset_and_picture",
        "test_an_undamped_mode_turns_at_its_own_frequency",
    ),
    "test_linearly_implicit": (
        "test_gradients_of_a_window_nest_with_vmap",
        "test_pendulum_agrees_with_kvaerno5",
        "test_march_is_the_history_and_lanes_do_not_matter",
        "test_other_laws_agree_with_kvaerno5",
    ),
    "test_energy_flow": (
        "test_rounded_corners_close_too",
        "test_other_laws_close_too[hunt_crossley]",
        "test_other_laws_close_too[rubber]",
        "test_laws_of_all_kinds_driven_by_a_chirp",
        "test_stops_that_let_go_and_several_of_them",
        "test_driven_motions_close[drive1]",
        "test_other_laws_close_too[hertz]",
        "test_a_release_closes_to_rounding",
    ),
    "test_settling": (
        "test_gradients_of_the_steady_state",
        "test_steady_states_are_those_of_a_long_march",
    ),
    "test_single_contact": (
        "test_folds_are_the_jumps[P_MR0.5_mu0.5]",
        "test_folds_are_the_jumps[P_MR1_mu0]",
        "test_folds_are_the_jumps[C_MR0.5_mu0.5_gap0.8]",
        "test_folds_are_the_jumps[C_MR1_mu0]",
        "test_folds_are_the_jumps[C_MR0.5_mu0]",
        "test_folds_on_the_grid",
        "test_folds_are_the_jumps[C_MR0.5_mu0.5_s1_0.75]",
        "test_folds_are_the_jumps[C_fig7_MR1.5_mu0]",
    ),
    "test_resonance": (
        "test_maps_and_regimes_flag_what_grows_without_bound",
        "test_branches_pass_begin_and_end_at_resonance",
        "test_derivative_of_a_periodic_response_at_resonance",
        "test_periodic_responses_at_resonance",
        "test_derivatives_at_resonance",
    ),
    "test_map_interrupted": (
        "test_death_before_any_change_of_the_files_is_mended_by_the_same_call[1]",
        "test_killed_again_and_again_a_map_ends_as_if_nothing_had_been",
    ),
    "test_states": (
        "test_other_methods_say_it_too",
        "test_in_a_batch_distances_are_numbers_and_nothing_is_warned_of",
        "test_a_motion_goes_on_from_its_last_state",
        "test_a_motion_of_a_lower_period_is_told",
    ),
    "test_history_misfit": (
        "test_driven_from_rest",
        "test_shifted_steady_motion_is_found",
        "test_a_measured_drive",
    ),
    "test_parameter_map": (
        "test_memory_bounds_the_chunks",
        "test_every_lane_is_what_a_single_call_gives",
    ),
    "test_frequency_sweep": (
        "test_no_stop",
        "test_point_force",
        "test_a_preloaded_stop",
        "test_every_reference_sweep[P_MR1_mu0-0.0001]",
        "test_every_reference_sweep[C_fig7_MR1.5_mu0-0.0001]",
        "test_every_reference_sweep[P_MR0.5_mu0.5-0.0001]",
        "test_every_reference_sweep[C_MR0.5_mu0-0.0001]",
    ),
    "test_lyapunov": ("test_periodic_motion_has_the_exponent_of_its_leading_multiplier[0.9331]",),
    "test_walks": (
        "test_stiff_stops_are_where_sweeps_settle",
        "test_touches_of_stiff_stops_where_the_curve_turns_sharply",
        "test_a_branch_that_comes_back_gives_way_to_the_one_from_the_high_end",
    ),
    "test_branch_references": (
        "test_folds_are_the_refined_jumps[C_fig7_MR1.5_mu0]",
        "test_oscillator",
        "test_two_masses_of_nlvib",
        "test_folds_are_the_refined_jumps[C_MR0.5_mu0]",
        "test_folds_are_the_refined_jumps[P_MR1_mu0]",
    ),
    "test_measures": (
        "test_derivatives_are_those_of_finite_differences[peak amplitude]",
        "test_derivatives_are_those_of_finite_differences[area]",
        "test_derivatives_are_those_of_finite_differences[area, lower]",
        "test_derivatives_are_those_of_finite_differences[peak of all motions]",
        "test_derivatives_are_those_of_finite_differences[mean force in a band]",
        "test_a_propagated_gap",
    ),
    "test_map_responses": (
        "test_a_measure_that_jax_cannot_trace_is_told_so",
        "test_no_derivative_where_there_is_no_steady_state",
    ),
    "test_map_damage": (
        "test_a_damaged_store_is_repaired_by_the_same_call_which_says_what_was_wrong",
    ),
    "test_basins": (
        "test_two_basins_are_those_of_plain_integration",
        "test_motions_without_a_period_are_one_class",
        "test_phases_of_one_orbit_are_one_attractor_or_several",
    ),
    "test_simulate_lists": (
        "test_releases_and_frequencies_are_axes_too",
        "test_sampling_rate",
        "test_a_function_without_a_list_gives_one_history",
        "test_new_numbers_do_not_compile_again",
    ),
    "test_zipped_axes": (
        "test_regimes_and_diagrams_of_a_group",
        "test_histories_of_a_group",
        "test_basins_of_a_group",
        "test_branches_of_a_group",
    ),
    "test_exact_contact": (
        "test_mirrored_rig_moves_mirrored",
        "test_a_lane_that_blows_up_leaves_its_neighbours_alone[nan]",
        "test_stops_on_either_side",
    ),
    "test_following": ("test_two_stops_are_followed_too",),
    "test_point_masses": (
        "test_gradient_of_a_batch",
        "test_gradients",
    ),
    "test_excitation": ("test_other_drives_than_a_displacement",),
    "test_periodic_response": ("test_points_of_the_reference",),
    "test_matrix_system": ("test_history_of_the_same_beam",),
    "test_splitting": ("test_two_stops_at_once_and_lanes_like_a_loop",),
    "test_jumps_at_folds": ("test_lanes_do_not_depend_on_their_neighbours",),
}
"""By file: slow tests whose like CI runs on another case or by another test; run by hand."""


def marks_of(file: str, name: str) -> list[str]:
    """Return the tiers of a test by its file and name, `test_x[case]`."""

    def is_in(table: dict[str, tuple[str, ...]]) -> bool:
        return any(name == one or name.startswith(f"{one}[") for one in table.get(file, ()))

    if is_in(LONG):
        return ["slow", "long"]
    if is_in(SLOW):
        return ["slow"]
    return ["quick"] if file in QUICK else []
