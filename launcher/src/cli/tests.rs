//! The command line's definition, checked without running anything.

use super::values::Place;
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
    let pose = still.pose;
    assert_eq!(pose.eye, Some(Place { x: -5.0, y: -6.5, z: Some(10.0) }));
    assert_eq!((pose.heading, pose.pitch, pose.roll), (Some(-90.0), Some(-20.0), None));
}

#[test]
fn the_arguments_of_other_programs_are_passed_on_as_they_are() {
    let words = ["ingest", "--elevation", "a.tif", "b.tif", "--help", "-o", "w.tv"];
    let Command::Ingest(args) = parse(&words).unwrap().command else { panic!("not ingest") };
    assert_eq!(args.arguments, words[1..]);
    let Command::Synth(args) = parse(&["synth", "--help"]).unwrap().command else { panic!("not synth") };
    assert_eq!(args.arguments, ["--help"]);
}

#[test]
fn wrong_values_are_usage_errors_that_say_what_was_expected() {
    for (words, expected) in [
        (&["fly", "w.tv", "-o", "a.mp4", "--size", "0x0"][..], "1280x720"),
        (&["fly", "w.tv", "-o", "a.mp4", "--frames", "5..5"], "A less than B"),
        (&["fly", "w.tv", "-o", "a.mp4", "--sky", "1,2,300"], "0 to 255"),
        (&["fly", "w.tv", "-o", "a.mp4", "--samples", "3"], "1 or 4"),
        (&["fly", "w.tv", "-o", "a.mp4", "--memory", "much"], "512MiB"),
        (&["still", "w.tv", "--eye", "1", "--heading", "0", "--pitch", "0", "-o", "a.png"], "two or three numbers"),
    ] {
        let error = parse(words).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains(expected), "{error}");
    }
}

#[test]
fn agl_takes_a_number_or_none() {
    for (arguments, expected) in [
        (&["fly", "w.tv", "-o", "x/"][..], None),
        (&["fly", "w.tv", "--agl", "-o", "x/"], Some(None)),
        (&["fly", "w.tv", "--agl", "80", "-o", "x/"], Some(Some(80.0))),
    ] {
        let Command::Fly(fly) = parse(arguments).unwrap().command else { panic!("not a flight") };
        assert_eq!(fly.course.agl.agl, expected);
    }
    let message = parse(&["fly", "--agl", "w.tv", "-o", "x/"]).unwrap_err().to_string();
    assert!(message.contains("stands last"), "{message}");
    assert!(parse(&["fly", "w.tv", "--camera", "shm:a", "--eye", "1,2", "-o", "x/"]).is_err());
}
