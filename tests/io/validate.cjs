// Prints what the Khronos validator finds in each file given.
const fs = require('fs');
const validator = require('gltf-validator');

Promise.all(
  process.argv.slice(2).map((path) => validator.validateBytes(new Uint8Array(fs.readFileSync(path)), { maxIssues: 50 }))
).then((reports) => console.log(JSON.stringify(reports)));
