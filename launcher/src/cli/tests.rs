//! The command line's definition, checked without running anything.

use super::*;
use clap::CommandFactory;

fn parse(words: &[&str]) -> Result<Cli, clap::Error> {
    Cli::try_parse_from(std::iter::once("terravision").chain(words.iter().copied()))
}

#[test]
fn the_definition_is_sound_and_every_command_has_help() {
    let mut command = Cli::command();
    command.clone().debug_assert();
    assert!(command.render_long_help().to_string().contains("EXIT STATUS"));
    for sub in command.get_subcommands() {
        assert!(sub.get_about().is_some(), "{} says nothing about itself", sub.get_name());
        for arg in sub.get_arguments() {
            assert!(arg.get_help().is_some(), "{} {} has no help", sub.get_name(), arg.get_id());
        }
    }
}

#[test]
fn negative_numbers_are_values() {
    let cli = parse(&["still", "w.tv", "--eye", "-5,-6.5,10", "--heading", "-90", "--pitch", "-20", "-o", "a.png"]);
    let Command::Still(still) = cli.unwrap().command else { panic!("not a still") };
    assert_eq!(still.eye, Triple([-5.0, -6.5, 10.0]));
    assert_eq!((still.heading, still.pitch, still.roll), (-90.0, -20.0, 0.0));
}

#[test]
fn the_arguments_of_other_programs_are_passed_on_as_they_are() {
    let words = ["ingest", "--elevation", "a.tif", "b.tif", "--help", "-o", "w.tv"];
    let Command::Ingest(passed) = parse(&words).unwrap().command else { panic!("not ingest") };
    assert_eq!(passed.arguments, words[1..]);
    let Command::Synth(passed) = parse(&["synth", "--help"]).unwrap().command else { panic!("not synth") };
    assert_eq!(passed.arguments, ["--help"]);
}

#[test]
fn wrong_values_are_usage_errors_that_say_what_was_expected() {
    for (words, expected) in [
        (&["fly", "w.tv", "-o", "a.mp4", "--size", "0x0"][..], "1280x720"),
        (&["fly", "w.tv", "-o", "a.mp4", "--frames", "5..5"], "A less than B"),
        (&["fly", "w.tv", "-o", "a.mp4", "--sky", "1,2,300"], "0 to 255"),
        (&["fly", "w.tv", "-o", "a.mp4", "--samples", "3"], "1 or 4"),
        (&["fly", "w.tv", "-o", "a.mp4", "--memory", "much"], "512MiB"),
        (&["still", "w.tv", "--eye", "1,2", "--heading", "0", "--pitch", "0", "-o", "a.png"], "three numbers"),
    ] {
        let error = parse(words).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains(expected), "{error}");
    }
}
