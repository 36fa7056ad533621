use super::*;
use proptest::prelude::*;

proptest! {
    #[test]
    fn a_text_comes_together_again(text in "\\PC{0,80}") {
        let events = Event::text(TextKind::Device, &text);
        let mut bytes = Vec::new();
        let last: Vec<bool> = events.iter().map(|event| event.collect_text(&mut bytes)).collect();
        let got = String::from_utf8(bytes).unwrap();
        prop_assert!(text.starts_with(&got) && got.len() >= text.len().min(TEXT_MAX - 3));
        prop_assert_eq!(last.iter().position(|is_last| *is_last), last.len().checked_sub(1));
    }

    #[test]
    fn a_foreign_piece_never_grows_the_text(thread: u32, frame: u64, value: u64) {
        let mut bytes = Vec::new();
        let _ = Event { thread, frame, value, ..Event::zeroed() }.collect_text(&mut bytes);
        prop_assert!(bytes.len() <= TEXT_MAX);
    }
}

#[test]
fn numbers_and_names_agree() {
    for name in SpanName::ALL {
        assert_eq!(SpanName::from_number(u64::from(name as u32)), Some(name));
    }
}

fn contents() -> impl Strategy<Value = EventContent> {
    let tile = (0u32..100, any::<bool>()).prop_map(|(m, is_color)| Tile {
        layer: if is_color { Layer::Color } else { Layer::Elevation },
        node: NodeId::new(m, 3, 2).unwrap(),
    });
    let failure = (0..TileFailure::ALL.len()).prop_map(|index| TileFailure::ALL[index]);
    let kinds = [TextKind::Device, TextKind::Driver, TextKind::Technique, TextKind::TechniqueReason, TextKind::Failure];
    let span = (0..SpanName::ALL.len(), tile.clone()).prop_map(|(index, tile)| {
        let name = SpanName::ALL[index];
        EventContent::Span { name, node: name.is_of_a_tile().then_some(tile.node) }
    });
    prop_oneof![
        span,
        (tile.clone(), failure).prop_map(|(tile, failure)| EventContent::TileUnavailable { tile, failure }),
        tile.prop_map(|tile| EventContent::TileCame { tile }),
        any::<u64>().prop_map(|triangles| EventContent::FrameDone { triangles }),
        any::<bool>().prop_map(|is_settled| EventContent::FrameWritten { is_settled }),
        any::<(u32, u32)>().prop_map(|(tiles, nodes)| EventContent::FrameWanted { tiles, nodes }),
        any::<u64>().prop_map(|tiles| EventContent::FrameUploaded { tiles }),
        any::<(f32, f32)>().prop_map(|(r_z_px, r_c_px)| EventContent::FrameCamera { r_z_px, r_c_px }),
        any::<(u32, f32)>().prop_map(|(tiles, sharp_share)| EventContent::FrameLacked { tiles, sharp_share }),
        (any::<bool>(), any::<u8>(), any::<u32>()).prop_map(|(is_mesh, view, tiles)| {
            let technique = if is_mesh { TechniqueChoice::Mesh } else { TechniqueChoice::Rays };
            EventContent::FrameDraw { technique, view, tiles }
        }),
        (0..kinds.len()).prop_map(move |index| EventContent::Text { kind: kinds[index] }),
    ]
}

proptest! {
    #[test]
    fn an_event_says_what_it_was_made_to_say(content in contents()) {
        prop_assert_eq!(Event::new(content).content(), Some(content));
    }

    #[test]
    fn any_bytes_say_what_can_be_said_again_or_nothing(kind in 0u32..24, value: u64, node: u64) {
        let event = Event { kind, value, node, ..Event::zeroed() };
        if let Some(content) = event.content() {
            // Compared as bits, because numbers may be NaN.
            let again = Event::new(content).content().unwrap();
            prop_assert_eq!(format!("{again:?}"), format!("{content:?}"));
        }
    }
}
