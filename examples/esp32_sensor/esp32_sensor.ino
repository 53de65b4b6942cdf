// A sensor on an ESP32: sends its temperature to the device gateway and takes the command setInterval.
// Library: ArduinoJson 7. With TLS, use WiFiClientSecure and setCACert instead of WiFiClient.

#include <ArduinoJson.h>
#include <WiFi.h>

const char *WIFI_NAME = "workshop";
const char *WIFI_PASSWORD = "…";
const char *GATEWAY = "192.168.7.2";
const uint16_t PORT = 54010;
const char *DEVICE = "hall-1";
const char *TOKEN = "hnd_device_…";  // `handover device add hall-1 --file sensor.yaml` prints it

WiFiClient gateway;
String boot = String(esp_random(), HEX);  // another one at each start: the memory of commands is gone
String lastCommand;
uint32_t intervalMs = 1000, sentMs = 0, delayMs = 500;
uint32_t seq = 0;
bool greeted = false;

void send(JsonDocument &message) {
  serializeJson(message, gateway);
  gateway.print('\n');
}

void answer(const String &id) {
  JsonDocument message;
  message["type"] = "ack";  // without a state it says: done
  message["id"] = id;
  send(message);
}

void connectToGateway() {
  greeted = false;
  delay(delayMs);  // also after a refusal, which comes over an open connection
  delayMs = min(delayMs * 2, (uint32_t)15000);
  if (!gateway.connect(GATEWAY, PORT)) return;
  JsonDocument hello;
  hello["type"] = "hello";
  hello["version"] = 1;
  hello["device"] = DEVICE;
  hello["token"] = TOKEN;
  hello["boot"] = boot;
  hello["measures"].add("temperature");
  hello["takes"].add("setInterval");
  send(hello);
}

void receive() {
  JsonDocument message;
  if (deserializeJson(message, gateway.readStringUntil('\n'))) return;
  const char *type = message["type"] | "";
  if (!strcmp(type, "ack") && !greeted) {
    greeted = true;
    delayMs = 500;
  } else if (!strcmp(type, "error")) {
    Serial.println(message["reason"] | "refused");
    if (message["retry"].is<bool>() && !message["retry"].as<bool>()) delayMs = 600000;  // a person has to look
  } else if (!strcmp(type, "command")) {
    String id = message["id"] | "";
    if (id != lastCommand && !strcmp(message["name"] | "", "setInterval")) {
      intervalMs = 1000 * max(message["parameters"]["seconds"] | 1.0, 0.1);
    }
    lastCommand = id;  // a command that arrives again is answered and not executed
    answer(id);
  }
}

void setup() {
  Serial.begin(115200);
  WiFi.begin(WIFI_NAME, WIFI_PASSWORD);
}

void loop() {
  if (WiFi.status() != WL_CONNECTED) {
    delay(200);
    return;
  }
  if (!gateway.connected()) connectToGateway();
  while (gateway.available()) receive();
  if (greeted && millis() - sentMs >= intervalMs) {
    sentMs = millis();
    JsonDocument message;  // without t: the gateway takes the time of arrival
    message["type"] = "telemetry";
    message["seq"] = ++seq;
    message["values"]["temperature"] = temperatureRead();
    send(message);
  }
}
