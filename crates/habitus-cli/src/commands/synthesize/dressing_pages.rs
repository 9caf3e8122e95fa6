//! What the server of `synthesize --interactive` answers.

use habitus_report::dressing_room::{DressingRoom, DressingScene};

use crate::local_server::{Answer, Method, Request};

/// The page and data of one dressing room.
pub struct DressingPages<'a> {
    room: &'a DressingRoom,
    /// The same for every reader, and megabytes.
    arrays: Vec<u8>,
}

impl<'a> DressingPages<'a> {
    /// Pages of a room.
    pub fn new(room: &'a DressingRoom) -> Self {
        Self { room, arrays: room.scene().bytes() }
    }

    /// The answer to a request.
    pub fn answer(&self, request: &Request) -> Answer {
        let scene = self.room.scene();
        match (request.method, request.parts().as_slice()) {
            (Method::Get, []) => Answer::page(scene.page()),
            (Method::Get, ["style.css"]) => Answer::style(DressingScene::style()),
            (Method::Get, ["script.js"]) => Answer::script(DressingScene::script()),
            (Method::Get, ["scene.json"]) => Answer::json(&scene.head()),
            (Method::Get, ["scene.bin"]) => Answer::binary(self.arrays.clone()),
            (Method::Get, ["sequence", question]) => match scene.choice(question) {
                Ok(choice) => Answer::binary(self.room.dress(&choice).bytes()),
                Err(error) => Answer::refusal(400, error.to_string()),
            },
            _ => Answer::not_found(),
        }
    }
}
