"""Other words for what ``phrases`` say, for ``rewordings``. For training only.

Markup as in ``phrases``; of ``(a|b|c)`` one is said, and an empty one is nothing.
"""

_ON_FOOT = "([hike]|[tread]|[trek]|[tramp]|[parade]|[promenade]|[ramble]|[toddle]|[strut]|[stroll]|[walk]|[walk]|[go])"
_SOME_WAY = "(some way|a bit|a few metres|a couple of metres|some steps|straight on|forwards|in front|a while)"
_SWERVE = (
    "([swerve]|[curve]|[pivot]|[swivel]|[turn]|[turn]|[wheel]|[arc]|[hook]|[swing]|[angle]|[loop]|[peel] off|[circle]|"
    "[deviate]|[branch] off|[shift]|[bear]|[rotate]|[break] off|[tack]|[sweep])"
)
_TO_LEFT = "(to the left|left|toward {their} left|to {their} left side|to the left side|to {their} left|on the left)"
_HAND = "(left hand|left arm|left palm)"
_HANDS = "(both hands|both arms|both palms|{their} arms|{their} hands)"
_LIFT = (
    "([hoist]|[elevate]|[throw] up|[push] up|[uplift]|[reach] up with|[put] up|[lift]|[raise]|[hold] up|[thrust] up)"
)
_HIGH = "(|high|above {their} head|above the shoulders|up into the air|to the sky|as far as it goes|skyward)"
_WAG = "([wag]|[wiggle]|[flutter]|[wave]|[wave]|[swish]|[waggle])"
_AT_SOMEONE = (
    "(|at someone|at the crowd|at a passer-by|to the camera|to say hello|happily|at someone far off|in the air)"
)

#: By content; left-hand variants alone, as in ``phrases``.
PHRASES: dict[str, tuple[str, ...]] = {
    "walk": (
        (
            f"{_ON_FOOT} (straight on|forwards|to the front|in a straight line|along the path|down the street|"
            "down the road)"
        ),
        f"{_ON_FOOT} (along a path|through the park|across the room|down a hallway|to the other side|toward the door)",
        "[make] {their} way (forward|along the path|down the street|across the room|straight on)",
        "[keep] (walking|on walking|going at a walk)",
        "([cover]|[cross]) (some ground|a few metres|the room) (walking|at a walk)",
        "([start]|[begin]) (walking|to walk|going)",
        "([move]|[come]) (forward|forwards|straight on|along) (by walking|at a walk|with even steps)",
        "[take] a (walk|stroll|few steps ahead|leisurely walk)",
        "[pass] by (walking|at a walk)",
    ),
    "walk-slow": (
        f"{_ON_FOOT} (forward|forwards|along|straight on|) (very slowly|at a snail's pace|without any rush|in no rush)",
        "([shuffle]|[trudge]|[dawdle]|[inch]|[drag] {their} feet) (along|forward|forwards|)",
        "[take] (tiny|cautious|small slow|careful) steps (forward|forwards|)",
        f"slowly {_ON_FOOT} (forward|along|ahead)",
    ),
    "walk-fast": (
        f"{_ON_FOOT} (forward|along|straight on|) (swiftly|rapidly|in a rush|very fast|as if late|at a quick tempo)",
        "power [walk] (forward|along|)",
        "[rush] (along|forward) (walking|without running)",
        "[take] (rapid|swift|fast|brisk) steps (forward|)",
    ),
    "walk-large-steps": (
        f"{_ON_FOOT} (forward|along|) (with wide steps|with massive steps|in long strides|with sweeping steps)",
        "[take] (massive|very long|wide|oversized) (steps|strides) (forward|)",
        "[step] (far|as far as possible) (forward|ahead) (each time|with every step)",
    ),
    "walk-around": (
        f"{_ON_FOOT} (in all directions|to and fro|in circles|up and down the room|about the room|all over the place)",
        "[walk] (up and down|to and fro|around the room)",
        "[mill] around",
        "[explore] the room (by walking|at a walk|)",
    ),
    "walk-turn-left": (
        f"{_ON_FOOT} {_SOME_WAY} and {_SWERVE} {_TO_LEFT}",
        f"{_ON_FOOT} {_SOME_WAY} and {_SWERVE} {_TO_LEFT}",
        f"{_ON_FOOT} {_SOME_WAY}, then {_SWERVE} {_TO_LEFT}",
        f"{_ON_FOOT} {_SOME_WAY} before (swerving|curving|pivoting|turning|swinging|looping|breaking off) {_TO_LEFT}",
        f"{_ON_FOOT} and {_SWERVE} {_TO_LEFT}",
        f"{_SWERVE} {_TO_LEFT} (while walking|as {{they}} walk|during a walk|at the crossing|in mid-walk|at the end)",
        f"{_ON_FOOT} (in an arc|in a bow|in a bend|along a curve|along an arc|in a semicircle) {_TO_LEFT}",
        (
            "[take] (a left|the left turn|a turn to the left|the next left|a left at the crossing|"
            "the left exit) (at a walk|)"
        ),
        (
            "([hang]|[make]|[do]) a (left|left turn|turn left|quarter turn to the left|"
            "left-hand turn) (as the path bends|at a walk|while walking|)"
        ),
        f"[keep] to a (path|curve|road|bend) (that curves|that turns|that swings|) {_TO_LEFT}",
        f"[change] (course|{{their}} way|route) {_TO_LEFT} (at a walk|while walking|)",
        "[go] left (at the crossing|at the turn|after a few steps|after some metres)",
        f"[start] straight and [end] up going {_TO_LEFT}",
    ),
    "walk-back": (
        f"{_ON_FOOT} (backwards|backward|to the rear|back without turning|in the reverse direction|tail first)",
        "[back] (off|up|away from someone|out of the room|off slowly)",
        "[take] (several|a few|a couple of) steps (back|backward|to the rear)",
        "([withdraw]|[recede]|[moonwalk]|[reverse]) (at a walk|by walking|step after step|)",
        "[move] (backward|to the rear|away) (at a walk|with {their} face to the front|while looking in front)",
    ),
    "walk-left": (
        f"{_ON_FOOT} (diagonally|sideways|at an angle|crosswise|obliquely) {_TO_LEFT}",
        "([sidle]|[sidestep]|[shuffle]|[edge]|[shift]) (to the left|left|toward the left) (at a walk|while walking|)",
        f"{_ON_FOOT} (to the front left|forward and left|to the left without turning|off to the left at an angle)",
    ),
    "run": (
        (
            "([scamper]|[gallop]|[hustle]|[jog]|[run]|[run]|[lollop]|[canter]) (forwards|straight on|"
            "along the path|down the street|to the front|)"
        ),
        "([start]|[begin]|[keep]) (running|jogging)",
        "[go] (jogging|running|for a jog)",
        "[move] (forward|along|forwards) (at a run|in a run|running|jogging)",
        "[run] (along|at a medium tempo|toward the finish|around the track|to the bus|after someone)",
        "[do] a (run|jog|lap of running)",
    ),
    "dash": (
        (
            "([sprint]|[race]|[rush]|[dart]|[tear]|[zip]|[speed] off|[fly]) (forwards|straight on|down the track|"
            "to the finish|along|)"
        ),
        (
            "[run] (flat out|at top speed|as if chased|like the wind|as quickly as {they} can|extremely fast|"
            "for {their} life)"
        ),
        "[break] into a (sprint|fast run|dash)",
        "[run] a (hundred metres|short race|sprint)",
    ),
    "wave-left-hand": (
        f"{_WAG} (the|{{their}}) {_HAND} {_AT_SOMEONE}",
        f"{_WAG} (the|{{their}}) {_HAND} {_AT_SOMEONE}",
        f"([hoist]|[lift]|[put] up|[hold] up) the {_HAND} and {_WAG} it {_AT_SOMEONE}",
        f"[say] (hello|hey|good morning) (with|by waving) the {_HAND}",
        f"[greet] (someone|the crowd|a neighbour|people) with the {_HAND}",
        f"[move] the {_HAND} from side to side {_AT_SOMEONE}",
        f"[wave] {_AT_SOMEONE} with the {_HAND}",
    ),
    "wave-both-hands": (
        f"{_WAG} {_HANDS} {_AT_SOMEONE}",
        f"{_WAG} {_HANDS} (wildly|above the head|to get attention|from side to side|in the air|to the crowd)",
        f"([hoist]|[lift]|[put] up|[hold] up) both arms and {_WAG} them {_AT_SOMEONE}",
        "[say] (hello|hey) (with|by waving) both (hands|arms)",
        "[greet] (someone|the crowd|a neighbour|people) with both (hands|arms)",
        f"[wave] {_AT_SOMEONE} with both (hands|arms)",
        "[move] both arms from side to side above the head",
    ),
    "raise-up-left-hand": (
        f"{_LIFT} the {_HAND} {_HIGH}",
        f"{_LIFT} {{their}} {_HAND} {_HIGH}",
        f"[point] the {_HAND} (straight up|to the sky|upwards)",
        "[volunteer] with the left hand up",
        "[ask] to speak by raising the left hand",
        f"[move] the {_HAND} (up|upwards|up high|to the sky)",
        f"[get] {{their}} {_HAND} up (high|into the air|)",
    ),
    "raise-up-both-hands": (
        f"{_LIFT} {_HANDS} {_HIGH}",
        f"{_LIFT} {_HANDS} {_HIGH}",
        f"[point] {_HANDS} (straight up|to the sky|upwards)",
        "[surrender] with both hands up",
        "[celebrate] with both arms in the air",
        f"[move] {_HANDS} (up|upwards|up high|to the sky)",
        f"[get] {_HANDS} up (high|into the air|)",
    ),
    "bow": (
        "[bow] (deeply|to the audience|in front of someone|before the king|in thanks|at the end|formally|once)",
        "[make] a (bow|deep bow|polite bow|small bow)",
        "[incline] {their} (head and body|upper body|head)",
        "[fold] {their} upper body forward (politely|to greet someone|in thanks|)",
        "[tilt] {their} (upper body|trunk) down (politely|in thanks|to greet someone)",
        "[greet] (someone|the guests of the house|the audience) with a bow",
    ),
    "bye": (
        "[wave] (someone off|at a leaving bus|at someone who leaves) with (the right|one) hand",
        f"{_WAG} (the right hand|the right arm|one hand) (goodbye|to say goodbye|to say bye|as someone leaves)",
        "[see] someone off with (one|the right) hand",
        "[take] leave with a wave of (the right|one) hand",
    ),
    "byebye": (
        "[wave] (someone off|at a leaving bus|at someone who leaves) with (both hands|both arms)",
        f"{_WAG} (both hands|both arms) (goodbye|to say goodbye|to say bye-bye|as someone leaves)",
        "[see] someone off with both (hands|arms)",
        "[take] leave with a wave of both (hands|arms)",
    ),
    "guide": (
        "[lead] (someone|a tourist|people) with the right (hand|arm)",
        "[point] (out the way|someone to the door|ahead for someone|people to their seats) (with the right hand|)",
        "[escort] (someone|people) with (one|the right) (hand|arm)",
        "[welcome] (someone|people) in with the right (hand|arm)",
        "[offer] the way with an open (right hand|hand|palm)",
        "[let] someone go first with a wave of the arm",
    ),
    "call": (
        "[yell] (loudly|out|for help|across the street|at the hills)",
        "[shout] (a name|for someone|across the street|out loud|with {their} hands around the mouth)",
        "[cry] out (loudly|to someone|)",
        "[put] both hands to the mouth and [shout]",
        "[roar] (at someone|loudly|)",
    ),
    "respond": (
        "[answer] (someone|a question|a shout) (with the left hand|by lifting the left arm|)",
        "[react] with (a raised left hand|the left hand up)",
        "[reply] (to someone|to a shout) (with the left hand|by putting up the left arm|)",
        "[say] yes with the left hand up",
    ),
    "dance-short": (
        "[dance] (briefly|a little|for joy|to a beat|in place|for a few beats)",
        "[perform] (a short dance|a few dance moves|a little dance)",
        "[jiggle] to music",
        "[do] a (little|quick|small) dance",
    ),
    "kick": (
        "[kick] (out|someone|with the leg|high|hard|an enemy|with force|a door|into the air)",
        "[do] a (front kick|high kick|hard kick|kick with one leg)",
        "[lash] out with (one leg|the leg)",
        "[attack] with (a kick|one leg)",
        "[thrust] a leg forward",
    ),
    "punch": (
        "[punch] (someone|hard|an enemy|a bag|with one hand|straight|with force)",
        "[box] (the air|someone|with both fists|)",
        "[hit] (someone|the air|a bag|an enemy) (with a fist|)",
        "[attack] with {their} (fist|fists)",
        "[thrust] a fist forward",
        "[throw] a (hook|right|straight punch|hard punch)",
    ),
    "slash": (
        "[slash] (someone|downward|at an enemy|diagonally|the air|with force)",
        "[swing] a (blade|sword|sabre|rod) (downward|hard|in front|at an enemy|)",
        "[strike] (down|an enemy) with a (sword|blade|sabre)",
        "[attack] with a (sword|blade|sabre)",
        "[chop] downward with a (sword|blade)",
    ),
    "jump": (
        "[jump] (once|up and down|vertically|high up|for joy|as high up as {they} can|over a rope)",
        "[leap] (into the air|straight up|for joy)",
        "[do] a (leap|high jump|vertical jump|jump in place)",
        "[skip] a rope",
    ),
    "jump-forward": (
        "[jump] (over a puddle|across a gap|forwards|to the front|as far as {they} can)",
        "[leap] (over a puddle|across a gap|forwards|to the front)",
        "[do] a (long jump|leap to the front|broad jump)",
    ),
    "reach-up": (
        "[reach] (for the top rack|for a lamp|up to grab something|as high up as {they} can)",
        "[get] something down from the top",
        "[raise] {their} heels and [reach] up",
    ),
    "pick-up": (
        "[pick] up (a coin|a box|a ball|something heavy|a pen) (from the floor|off the floor|)",
        "[lift] (a box|something heavy|a ball) (from the floor|off the floor|)",
        "[crouch] and [grab] something",
        "[reach] down and [take] something",
    ),
    "swordplay": (
        "[fence] (with someone|)",
        "[attack] and [parry] with a sword",
        "[swing] a (sword|blade|sabre) (around|wildly|again and again)",
        "[drill] with a sword",
    ),
    "wash": (
        "[shower]",
        "[soap] {their} (arms|body|chest)",
        "[scrub] (everywhere|{their} back|with a sponge)",
        "[clean] (up in the shower|with soap|everywhere)",
    ),
    "laugh": (
        "[chuckle]",
        "[cackle]",
        "[laugh] (hard|until it hurts|at something funny|loudly|hysterically)",
        "[howl] with laughter",
    ),
    "drink": (
        "[sip] (a drink|juice|tea|some coffee)",
        "[swallow] (a drink|some juice)",
        "[drink] (some juice|a glass of juice|a cup of tea|from a glass|from a can)",
        "[enjoy] a drink",
    ),
    "exercise": (
        "[do] (aerobics|calisthenics|some sport|morning gymnastics)",
        "[work] out (hard|in a gym|)",
        "[warm] up (before a race|for sport|)",
        "[keep] fit with gymnastics",
    ),
    "salsa": (
        (
            "[dance] (salsa steps|in salsa style|a hot salsa|like in Cuba|a Cuban dance|salsa at a party|"
            "with a partner to salsa)"
        ),
        "[perform] (a salsa|a salsa number|a Cuban dance|mambo steps|salsa turns)",
        "[do] (salsa moves|mambo|a mambo|Cuban dance steps|salsa turns|ballroom salsa)",
        "[practice] (salsa|salsa steps|mambo)",
        "[swing] {their} hips to salsa",
    ),
    "ballet": (
        "[dance] (on tiptoe|in classic style|Swan Lake|like a swan|on pointe)",
        "[practice] (ballet|ballet steps|an arabesque|plies)",
        "[perform] (Swan Lake|ballet steps|an arabesque|a plie)",
        "[do] (a ballet dance|ballet jumps|ballet turns|an arabesque)",
        "[twirl] (gracefully|on tiptoe)",
    ),
    "dance": (
        "[dance] (freely|wildly|with all {their} heart|across the floor|with large movements)",
        "[perform] (an entire dance|modern dance|a choreography)",
        "[do] (modern dance|a choreography)",
    ),
    "dribble": (
        "[dribble] (a ball|with one hand|around someone|down the floor|forward)",
        "[tap] a ball to the floor again and again",
        "[play] with a basketball",
    ),
    "kick-ball": (
        "[kick] (the ball|a ball hard|a ball into the goal)",
        "[shoot] (a ball|at the goal|a goal)",
        "[pass] a soccer ball",
    ),
    "karate": (
        "[do] (kung fu|martial arts|karate moves|taekwondo)",
        "[practice] (kung fu|judo|karate kicks and punches|taekwondo)",
        "[drill] karate",
    ),
}  # fmt: skip
