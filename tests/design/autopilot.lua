-- Runs a script as ArduPilot does: its calls, a clock that may be late, a switch, servos; prints what is logged and set.
-- lua5.4 autopilot.lua SCRIPT JITTER_MS SWITCH_OFF_S

local script, jitter, off = arg[1], tonumber(arg[2]), tonumber(arg[3])
local now, line, expires = 0, {}, 0
local Time = {}
Time.__index = Time
Time.__sub = function(a, b) return setmetatable({ms = a.ms - b.ms}, Time) end
function Time:tofloat() return self.ms + 0.0 end
function millis() return setmetatable({ms = now}, Time) end

local PARAMETERS = { -- two ailerons, one of them reversed
  SERVO1_FUNCTION = 4, SERVO2_FUNCTION = 19, SERVO3_FUNCTION = 70, SERVO4_FUNCTION = 21, SERVO5_FUNCTION = 4,
  SERVO5_REVERSED = 1, SERVO2_TRIM = 1480, SERVO6_FUNCTION = 77, SERVO7_FUNCTION = 78, SERVO10_FUNCTION = 79,
  SERVO11_FUNCTION = 80,
}
local DEFAULTS = {FUNCTION = 0, MIN = 1000, TRIM = 1500, MAX = 2000, REVERSED = 0}
param = {}
function param:get(name) return PARAMETERS[name] or DEFAULTS[name:match("_(%u+)")] end
SRV_Channels = {}
local COMMANDS = {[70] = 40.0}
function SRV_Channels:get_output_scaled(servo) return COMMANDS[servo] or 225.0 end
function SRV_Channels:set_output_pwm_chan_timeout(channel, width, timeout)
  assert(math.type(channel) == "integer" and math.type(width) == "integer" and math.type(timeout) == "integer")
  assert(width >= 1000 and width <= 2000 and timeout > 0)
  line[channel + 1] = width
end
arming = {is_armed = function() return true end}
gcs = {send_text = function(_, _, text) io.stderr:write(text, "\n") end}
rc = {}
function rc:find_channel_for_option(option)
  assert(option == 300)
  return {get_aux_switch_pos = function() return (now < 500 or now / 1000 >= off) and 0 or 2 end}
end
logger = {}
function logger:write(name, labels, format, ...)
  assert(name == "PLAN" and #format == select("#", ...) and #labels <= 64)
  line.logged = {...}
end

local update, delay = dofile(script)
while update and now < 100000 do
  line = {}
  update, delay = update()
  if line.logged then
    local row = {}
    for _, value in ipairs(line.logged) do row[#row + 1] = string.format("%.17g", value) end
    for channel = 1, 11 do row[#row + 1] = tostring(line[channel] or 0) end
    print(table.concat(row, ","))
  end
  now = now + delay + (jitter > 0 and (now * 7) % (jitter + 1) or 0)
end
